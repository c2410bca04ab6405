"""Encodes the measurements of a rig as members of a sample of format `webdataset`. Writes no files."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
from isal import igzip
from numpy.typing import NDArray

from factory.dataset.episode import Episode
from factory.export.rig.reader import SensorReader, arrays_of
from schemas.encoding.ndarray import encode_npy
from schemas.encoding.png import encode_png
from schemas.rig import CameraOutput, Imu, Sensor, WheelOdometry

_GZIP_LEVEL = 3
# a depth image of a warehouse takes 83 kB at level 3 of isal (2.7 ms), and 199 kB at level 1 (0.7 ms)
MEMBERS_TEXT = """\
| `<camera>.rgb.png` | 8 bit |
| `<camera>.depth.npy.gz` | float32 metres, axial or radial as `rig.json` has it, 0 where nothing was hit |
| `<camera>.ids.npy.gz` | uint16 instance ids; 0 is background |
| `<camera>.normals.npy.gz`, `<camera>.flow.npy.gz` | float32 unit normals; flow to the camera's next image, pixels |
| `<lidar>.ranges.npy.gz`, `<lidar>.ids.npy.gz` | float32 metres (lines, samples), 0 without a return; uint16 ids |
| `<imu>.motion.json` | `steps`, `angular_velocity` rad/s, `specific_force` m/s2 since the last sample |
| `<odometry>.motion.json` | `steps`, `ticks`, `poses` x, y, heading, `twists` since the last sample |
| `sensors.json` | sensor -> control step of its measurement: the latest at or before `step` |
"""
"""Rows of the card's table of members."""


def rig_members(reader: SensorReader, steps: Sequence[int]) -> Callable[[Episode, int], Iterator[tuple[str, bytes]]]:
    """Returns a function that yields suffix and bytes of each member of the sample of an exported step.

    All samples have the same suffixes, which the streaming readers require.
    """
    before = dict(zip(steps[1:], steps[:-1], strict=True))

    def members(_episode: Episode, t: int) -> Iterator[tuple[str, bytes]]:
        for sensor in reader.rig.sensors:
            yield from _members(reader, sensor, before.get(t, -1), t)
        seen = (one.name for one in reader.rig.sensors if one.name not in reader.motion)
        yield "sensors.json", json_member({name: reader.latest_step(name, t) for name in seen})

    return members


def _members(reader: SensorReader, sensor: Sensor, previous: int, t: int) -> Iterator[tuple[str, bytes]]:
    if isinstance(sensor, Imu | WheelOdometry):
        stride = reader.strides[sensor.name]
        numbers = range(previous // stride + 1, t // stride + 1)
        values = {
            name: array[numbers.start : numbers.stop] for name, array in arrays_of(reader.motion[sensor.name]).items()
        }
        steps = [stride * number for number in numbers]
        listed = {name: array.tolist() for name, array in values.items()}
        yield f"{sensor.name}.motion.json", json_member({"steps": steps} | listed)
        return
    for name, array in reader.arrays(sensor, t).items():
        if name == CameraOutput.RGB:
            yield f"{sensor.name}.{name}.png", encode_png(array)
        else:
            yield f"{sensor.name}.{name}.npy.gz", array_member(array)


def array_member(array: NDArray[np.generic]) -> bytes:
    """Returns an array as gzipped `.npy`.

    Ids are stored in this form, too, because the decoder "rgb" of webdataset converts 16-bit PNG to 8 bits and clips
    ids at 255.
    """
    return igzip.compress(encode_npy(array), _GZIP_LEVEL, mtime=0)


def json_member(values: dict[str, Any]) -> bytes:
    """Returns values as compact JSON."""
    return json.dumps(values, ensure_ascii=False, separators=(",", ":")).encode()
