"""Writes the measurements of a rig for format `paper`: one folder per sensor, with one file per image or scan."""

from __future__ import annotations

from pathlib import Path

from factory.export.rig.reader import SensorReader, arrays_of
from schemas.encoding.ndarray import encode_npy
from schemas.encoding.png import encode_png
from schemas.rig import CameraOutput, Imu, WheelOdometry

FOLDERS_TEXT = """\
- `episodes/ep_000001/sensors/<sensor>/`: the sensors of the rig; the number of a file is the control step of the
  measurement. Cameras: `rgb/000000.png`, `depth/000000.npy` (float32 metres, axial or radial as `rig.json` has it),
  `ids/000000.png`, `normals/000000.npy`, `flow/000000.npy`. Lidars: `ranges/000000.npy` (lines, samples) float32
  metres, 0 without a return, and `ids/000000.png`. IMU: `angular_velocity.npy` (N, 3) rad/s, `specific_force.npy`
  (N, 3) m/s2. Odometry: `ticks.npy` (N, 2), `poses.npy` (N, 3) x, y, heading, `twists.npy` (N, 2). Row i of N was
  measured at step i times `every_steps` of `rig.json`.
"""
"""Text of the card."""


def write_sensors(reader: SensorReader, steps: int, folder: Path) -> None:
    """Writes `<folder>/<sensor>/` for each sensor of the rig, for an episode of `steps` steps."""
    for name, motion in reader.motion.items():
        for array, values in arrays_of(motion).items():
            _write(folder / name / f"{array}.npy", encode_npy(values))
    for sensor in reader.rig.sensors:
        if isinstance(sensor, Imu | WheelOdometry):
            continue
        for t in range(0, steps, reader.strides[sensor.name]):
            for name, image in reader.arrays(sensor, t).items():
                is_png = name in (CameraOutput.RGB, CameraOutput.IDS)
                file = folder / sensor.name / name / f"{t:06d}.{'png' if is_png else 'npy'}"
                _write(file, encode_png(image) if is_png else encode_npy(image))


def _write(path: Path, data: bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data)
