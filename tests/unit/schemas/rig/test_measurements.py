"""Measurements of a rig in a bundle: round trips, digests, refusal, and bundles without a rig."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Mapping

import numpy as np
import pytest

from schemas.bundle import BundleReader
from schemas.encoding.arrays import ArraySpec
from schemas.encoding.container import ContainerWriter
from schemas.episode import BUNDLE_WITH_RIG, FORMAT_WITHOUT_RIG
from schemas.errors import InvalidBundle
from schemas.rig import Imu, Lidar2d, Mount, PinholeCamera, Rig, WheelOdometry
from schemas.rig.arrays import MAX_MEASURED_IMAGES, arrays_of, rig_faults
from schemas.rig.measurements import Arrays, measurements_of
from schemas.view import ViewSettings
from tests.builders.bundle import BundleParts, bundle_bytes, empty_arrays, job_for, parts_for

MOUNT = Mount(x_m=0.2, z_m=0.5)
EVERY = ("rgb", "depth", "ids", "normals", "flow")
CAMERA = PinholeCamera(
    name="front", model="pinhole", mount=MOUNT, rate_hz=20, width=16, height=8, fov_deg=90, outputs=EVERY
)
LIDAR = Lidar2d(name="scan", model="lidar2d", mount=MOUNT, rate_hz=10, samples=9, range_min_m=0.1, range_max_m=20)
IMU = Imu(name="imu", model="imu", mount=MOUNT)
WHEELS = WheelOdometry(name="wheels", model="odometry")
RIG = Rig(name="all", sensors=(CAMERA, LIDAR, IMU, WHEELS))


def random_arrays(specs: Mapping[str, ArraySpec]) -> Arrays:
    rng = np.random.default_rng(len(specs))
    return {name: (empty + rng.random(empty.shape)).astype(empty.dtype) for name, empty in empty_arrays(specs).items()}


def rigged_parts(rig: Rig = RIG) -> BundleParts:
    parts = parts_for(job_for(view=ViewSettings(rig=rig)))
    parts.measure = random_arrays
    return parts


def without(data: bytes, *names: str) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(data)) as found, ContainerWriter(buffer) as out:
        for name in found.namelist():
            if name not in names:
                out.add(name, found.read(name))
    return buffer.getvalue()


def test_every_array_of_every_sensor_is_read_back_as_written() -> None:
    with BundleReader(io.BytesIO(rigged_parts().write())) as bundle:
        assert (bundle.has_sensors, bundle.has_frames, bundle.meta.format) == (True, True, BUNDLE_WITH_RIG)
        for sensor in RIG.sensors:
            for t, specs in measurements_of(sensor, bundle.length, bundle.control_hz):
                found, written = bundle.measurement(sensor, t), random_arrays(specs)
                assert list(found) == list(written)
                for name, array in written.items():
                    assert found[name].dtype == specs[name].dtype
                    assert np.array_equal(found[name], array)


def test_a_sensor_has_measurements_at_its_rate_and_the_last_image_has_no_flow() -> None:
    steps = {sensor.name: list(measurements_of(sensor, 12, 60)) for sensor in RIG.sensors}
    assert [t for t, _ in steps["front"]] == [0, 3, 6, 9]
    assert [list(specs) for _, specs in steps["front"]] == [list(EVERY)] * 3 + [list(EVERY[:-1])]
    assert [t for t, _ in steps["scan"]] == [0, 6]
    assert [t for t, _ in steps["imu"]] == [None]


def test_a_bundle_without_a_rig_keeps_its_format() -> None:
    with BundleReader(io.BytesIO(bundle_bytes())) as bundle:
        assert (bundle.has_sensors, bundle.meta.format) == (False, FORMAT_WITHOUT_RIG)
        assert not bundle.meta.model_dump().keys() & {"sensor_digests"}
        assert "view" not in bundle.meta.job.model_dump()


def test_the_content_digest_covers_the_measurements_and_the_states_digest_does_not() -> None:
    changed = rigged_parts()
    changed.measure = empty_arrays
    metas = [rigged_parts().sealed(), changed.sealed(), parts_for().sealed()]
    assert len({meta.content_digest for meta in metas}) == 3
    assert len({meta.canonical_states() for meta in metas}) == 1


@pytest.mark.parametrize("name", ["sensors/front/flow/000003.npy.zst", "sensors/imu/specific_force.npy.zst"])
def test_a_missing_measurement_is_named(name: str) -> None:
    with pytest.raises(InvalidBundle, match=f"1 members missing, first '{name}'"):
        BundleReader(io.BytesIO(without(rigged_parts().write(), name)))


@pytest.mark.parametrize(
    ("sensor", "name", "value", "expected"),
    [
        (LIDAR, "ranges", 21.0, "scan/ranges: maximum 21.0 is above 20.0 m"),
        (IMU, "angular_velocity", np.nan, "imu/angular_velocity: contains NaN or infinity"),
        (CAMERA, "normals", 2.0, "front/normals: maximum 2.0 is above"),
        (CAMERA, "depth", -1.0, "front/depth: minimum -1.0 is below 0.0 m"),
    ],
)
def test_values_out_of_bounds_are_neither_written_nor_read(
    sensor: PinholeCamera, name: str, value: float, expected: str
) -> None:
    parts = rigged_parts(Rig(name="one", sensors=(sensor,)))

    def measure(specs: Mapping[str, ArraySpec]) -> Arrays:
        return {key: np.full_like(array, value if key == name else 0) for key, array in empty_arrays(specs).items()}

    parts.measure = measure
    with pytest.raises(InvalidBundle, match=expected):
        parts.write()


def test_a_rig_with_more_images_than_a_bundle_can_have_is_refused() -> None:
    cameras = tuple(CAMERA.model_copy(update={"name": f"c{n}", "rate_hz": None}) for n in range(13))
    (fault,) = rig_faults(Rig(name="many", sensors=cameras), 60, 1000)
    assert f"gives 65000 images and scans in an episode of 1000 steps, at most {MAX_MEASURED_IMAGES}" in fault
    assert rig_faults(Rig(name="many", sensors=cameras), 60, 900) == []


def test_the_error_of_a_rate_that_does_not_divide_the_control_rate_names_the_sensor() -> None:
    (fault,) = rig_faults(RIG, 50, 1000)
    assert "sensor 'front': rate_hz 20 does not divide the control rate, 50 Hz" in fault


def test_a_rig_that_is_written_without_defaults_is_read_back() -> None:
    view = ViewSettings(rig=RIG)
    again = ViewSettings.model_validate_json(view.model_dump_json())
    assert again == view
    assert again.rig is not None
    assert again.rig.digest == RIG.digest
    assert set(arrays_of(CAMERA)) == set(EVERY)
