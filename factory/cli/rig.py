"""`factory rig`: lists, shows and checks sensor rigs. Renders nothing."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from factory.cli.groups import CommandGroup
from factory.cli.options import complete_rig, count_option, json_option
from schemas.builtin import BUILTIN_RIGS, DEFAULT_CONTROL_HZ

if TYPE_CHECKING:
    from schemas.rig import Sensor

_rig_argument = click.argument("rig", metavar="RIG", shell_complete=complete_rig)
_control_option = count_option(
    "--control-hz", DEFAULT_CONTROL_HZ, "Control rate that the rates of the sensors must divide, Hz.", most=240
)


@click.group("rig", cls=CommandGroup)
def command() -> None:
    """List, show and check sensor rigs."""


@command.command("list")
@json_option
def list_(as_json: bool) -> None:
    """List the built-in rigs."""
    from factory.support.terminal import print_json, print_table
    from schemas.rig.rig_file import load_rig

    rigs = [load_rig(name) for name in BUILTIN_RIGS]
    if as_json:
        print_json([{"name": rig.name, "summary": rig.summary, "sensors": len(rig.sensors)} for rig in rigs])
    else:
        print_table("", ("rig", "sensors", "summary"), [(rig.name, len(rig.sensors), rig.summary) for rig in rigs])


@command.command("show")
@_rig_argument
@_control_option
@click.option("--toml", "as_toml", is_flag=True, help="Print the rig as TOML, to edit it.")
@json_option
def show(rig: str, control_hz: int, as_toml: bool, as_json: bool) -> None:
    """Show the sensors of a rig.

    RIG is a built-in rig (see `factory rig list`) or a TOML file.
    """
    import tomli_w

    from factory.support.terminal import print_json, print_table, print_text
    from schemas.rig.rig_file import load_rig

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


@command.command("check")
@_rig_argument
@_control_option
@json_option
def check(rig: str, control_hz: int, as_json: bool) -> None:
    """Check a rig file, and that its cameras can be rendered.

    RIG is a built-in rig or a TOML file. Exits with 2 and lists all mistakes if the rig is not valid.
    """
    from factory.support.terminal import print_json, print_text
    from schemas.rig.rig_file import load_rig
    from workers.geometry.faces import plan_faces

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
    from schemas.rig import Imu, Lidar2d, Lidar3d, WheelOdometry

    rate, resolution = f"{sensor.rate_hz or control_hz:g}", None
    match sensor:
        case WheelOdometry():
            return sensor.name, sensor.model, rate, f"{sensor.ticks_per_turn} ticks per turn", None, None
        case Lidar3d():
            resolution = f"{len(sensor.elevations_deg)} lines of {sensor.samples} rays"
        case Lidar2d():
            resolution = f"{sensor.samples} rays"
        case Imu():
            pass
        case _:
            resolution = f"{sensor.width} x {sensor.height} px"
    mount = sensor.mount
    position = f"{mount.x_m:g}, {mount.y_m:g}, {mount.z_m:g}"
    turn = f"{mount.roll_deg:g}, {mount.pitch_deg:g}, {mount.yaw_deg:g}"
    return sensor.name, sensor.model, rate, resolution, position, turn
