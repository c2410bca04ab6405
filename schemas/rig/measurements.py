"""Members of a bundle with the measurements of a rig: names, encoding, decoding and digests of their arrays.

A camera or lidar has one member for each array and measurement, `sensors/NAME/ARRAY/STEP`; a sensor of motion has one
for each array, `sensors/NAME/ARRAY`. Opens no container.

Design: docs/design/data.md#a-rig-beside-the-recorded-camera.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any

import numpy as np
import xxhash
from numpy.typing import NDArray

from schemas.encoding.arrays import ArraySpec
from schemas.encoding.ndarray import decode_npy_zst, encode_npy_zst
from schemas.encoding.png import decode_png, encode_png
from schemas.errors import InvalidBundle
from schemas.rig import Rig, Sensor
from schemas.rig.arrays import arrays_at, arrays_of, is_of_motion, measured_steps

SENSORS = "sensors/"
"""Start of the name of each member with measurements."""
Arrays = Mapping[str, NDArray[Any]]
"""Arrays of one measurement, or of a sensor of motion over an episode, by name."""
_SLACK_BYTES = 4096


def member_of(spec: ArraySpec, t: int | None) -> str:
    """Returns the name of the member of an array; `t` is the step, or `None` for a sensor of motion."""
    kind = "png" if _is_image(spec) else "npy.zst"
    return f"{SENSORS}{spec.name}.{kind}" if t is None else f"{SENSORS}{spec.name}/{t:06d}.{kind}"


def measurements_of(sensor: Sensor, length: int, control_hz: int) -> Iterator[tuple[int | None, dict[str, ArraySpec]]]:
    """Yields step and specs of each measurement of an episode, in order; a sensor of motion has one without step."""
    if is_of_motion(sensor):
        yield None, arrays_of(sensor)
        return
    for t in measured_steps(sensor, length, control_hz):
        yield t, arrays_at(sensor, t, length, control_hz)


def members_of_rig(rig: Rig, length: int, control_hz: int) -> Iterator[str]:
    """Yields the names of all members of a rig in an episode of `length` steps, in the order of the file."""
    for sensor in rig.sensors:
        for t, specs in measurements_of(sensor, length, control_hz):
            yield from (member_of(spec, t) for spec in specs.values())


def encode_array(spec: ArraySpec, array: NDArray[Any]) -> bytes:
    """Returns an array as its member stores it: PNG for colour and ids, compressed `.npy` for others."""
    return encode_png(array) if _is_image(spec) else encode_npy_zst(array, checksum=False)


def decode_array(spec: ArraySpec, data: bytes, rows: int) -> NDArray[Any]:
    """Decodes a member and checks it against its spec.

    Args:
        spec: spec of the array.
        data: content of the member.
        rows: number of measurements of a sensor of motion; not used by other arrays.

    Raises:
        InvalidBundle: the member is damaged, or its values are out of bounds.
    """
    shape = tuple(rows if side is None else side for side in spec.shape)
    array: NDArray[Any]
    if _is_image(spec):
        array = decode_png(spec.name, data, shape)
    else:
        limit = math.prod(shape) * np.dtype(spec.dtype).itemsize + _SLACK_BYTES
        array = decode_npy_zst(spec.name, data, dtype=spec.dtype, shape=shape, max_bytes=limit)
    findings = spec.violations(array, rows)
    if findings:
        raise InvalidBundle("measurement refused", findings)
    return array


class MeasurementWriter:
    """Writer of measurements that computes the digest of each sensor.

    Args:
        add: appends a member to the container.
    """

    def __init__(self, add: Callable[[str, bytes], None]) -> None:
        self._add = add
        self._digests: dict[str, MeasurementDigest] = {}

    def add(self, sensor: Sensor, t: int | None, arrays: Arrays) -> None:
        """Appends one measurement of a sensor; a sensor of motion has one, without a step.

        Raises:
            InvalidBundle: an array contradicts its spec.
        """
        specs = {name: spec for name, spec in arrays_of(sensor).items() if name in arrays}
        for name, spec in specs.items():
            findings = spec.violations(arrays[name])
            if findings:
                raise InvalidBundle("measurement refused", findings)
            self._add(member_of(spec, t), encode_array(spec, arrays[name]))
        self._digests.setdefault(sensor.name, MeasurementDigest()).add(arrays[name] for name in specs)

    @property
    def digests(self) -> dict[str, str]:
        """Digests of the measurements so far, by sensor."""
        return {name: digest.hexdigest() for name, digest in self._digests.items()}


def read_measurement(
    read: Callable[[str], bytes], sensor: Sensor, t: int | None, length: int, control_hz: int
) -> dict[str, NDArray[Any]]:
    """Returns the stored arrays of one measurement by name.

    Args:
        read: returns the content of a member.
        sensor: sensor of the rig of the episode.
        t: step at which the sensor measures; `None` for a sensor of motion.
        length: number of steps of the episode.
        control_hz: control rate, steps per second.

    Raises:
        InvalidBundle: an array is missing, damaged or out of bounds.
    """
    specs = arrays_of(sensor) if t is None else arrays_at(sensor, t, length, control_hz)
    rows = len(measured_steps(sensor, length, control_hz))
    return {name: decode_array(spec, read(member_of(spec, t)), rows) for name, spec in specs.items()}


class MeasurementDigest:
    """XXH3-128 over the arrays of all measurements of a sensor, in the order of the file."""

    def __init__(self) -> None:
        self._digest = xxhash.xxh3_128()

    def add(self, arrays: Iterable[NDArray[Any]]) -> None:
        for array in arrays:
            self._digest.update(np.ascontiguousarray(array).data)

    def hexdigest(self) -> str:
        """Returns the digest of the measurements so far as 32 hexadecimal digits."""
        return self._digest.hexdigest()


def _is_image(spec: ArraySpec) -> bool:
    return spec.dtype in (np.uint8, np.uint16)
