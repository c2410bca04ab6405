"""`factory rig`: lists, shows and checks sensor rigs. Renders nothing."""

from __future__ import annotations

from typing import Any

import click
import tomli_w

from factory.commands.common.output import print_json, print_table, print_text
from schemas.builtin import BUILTIN_RIGS
from schemas.rig import Imu, Lidar2d, Lidar3d, Sensor, WheelOdometry
from schemas.rig.rig_file import load_rig
from workers.geometry.faces import plan_faces


def list_(as_json: bool) -> None:
    """Executes `factory rig list`."""
    rigs = [load_rig(name) for name in BUILTIN_RIGS]
    if as_json:
        print_json([{"name": rig.name, "summary": rig.summary, "sensors": len(rig.sensors)} for rig in rigs])
    else:
        print_table("", ("rig", "sensors", "summary"), [(rig.name, len(rig.sensors), rig.summary) for rig in rigs])


def show(rig: str, control_hz: int, as_toml: bool, as_json: bool) -> None:
    """Executes `factory rig show`."""
    loaded = load_rig(rig, control_hz)
    if as_json:
        print_json(loaded.model_dump(mode="json"))
        return
    if as_toml:
        click.echo(tomli_w.dumps(loaded.model_dump(mode="json", exclude_defaults=True, exclude_none=True)), nl=False)
        return
    print_text(f"rig {loaded.name}: {loaded.summary}")
    columns = ("sensor", "model", "Hz", "resolution", "position in base_link, m", "roll, pitch, yaw, degrees")
    print_table("", columns, [_row(sensor, control_hz) for sensor in loaded.sensors])
    if loaded.source:
        print_text(f"source: {' '.join(loaded.source.split())}")


def check(rig: str, control_hz: int, as_json: bool) -> None:
    """Executes `factory rig check`."""
    loaded = load_rig(rig, control_hz)
    plans = {camera.name: plan_faces(camera) for camera in loaded.cameras}
    rendered: dict[str, Any] = {name: [plan.width, plan.height, len(plan.faces)] for name, plan in plans.items()}
    if as_json:
        print_json({"rig": loaded.name, "sensors": len(loaded.sensors), "rendered": rendered})
        return
    print_text(f"rig {loaded.name} is valid: {len(loaded.sensors)} sensors")
    for name, (width, height, faces) in rendered.items():
        print_text(
            f"  {name}: rendered as {faces} perspective {'image' if faces == 1 else 'images'}, {width} x {height} px"
        )


def _row(sensor: Sensor, control_hz: int) -> tuple[object, ...]:
    rate = f"{sensor.rate_hz or control_hz:g}"
    if isinstance(sensor, WheelOdometry):
        return sensor.name, sensor.model, rate, f"{sensor.ticks_per_turn} ticks per turn", None, None
    mount = sensor.mount
    position = f"{mount.x_m:g}, {mount.y_m:g}, {mount.z_m:g}"
    turn = f"{mount.roll_deg:g}, {mount.pitch_deg:g}, {mount.yaw_deg:g}"
    return sensor.name, sensor.model, rate, _resolution(sensor), position, turn


def _resolution(sensor: Sensor) -> str | None:
    match sensor:
        case Lidar3d():
            return f"{len(sensor.elevations_deg)} lines of {sensor.samples} rays"
        case Lidar2d():
            return f"{sensor.samples} rays"
        case Imu() | WheelOdometry():
            return None
    return f"{sensor.width} x {sensor.height} px"
