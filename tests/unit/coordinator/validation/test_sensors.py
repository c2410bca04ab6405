"""Validation of the measurements of a rig."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Mapping

import numpy as np

from coordinator.validation.messages import Scope
from coordinator.validation.validate import validate
from schemas.bundle import BundleReader
from schemas.encoding.arrays import ArraySpec
from schemas.encoding.container import ContainerWriter
from schemas.episode import FORMAT_WITHOUT_RIG
from schemas.rig import Lidar2d, Mount, Rig
from schemas.rig.measurements import Arrays
from schemas.view import ViewSettings
from tests.builders.bundle import BundleParts, empty_arrays, job_for, parts_for

LIDAR = Lidar2d(name="scan", model="lidar2d", mount=Mount(z_m=0.5), samples=9, range_min_m=0.1, range_max_m=20)
RIG = Rig(name="one", sensors=(LIDAR,))


def rigged_parts() -> BundleParts:
    return parts_for(job_for(view=ViewSettings(rig=RIG)))


def findings(data: bytes, scope: Scope = Scope.ALL) -> list[str]:
    with BundleReader(io.BytesIO(data)) as bundle:
        return validate(bundle, scope=scope)


def test_a_bundle_with_measurements_is_valid() -> None:
    assert findings(rigged_parts().write()) == []


def test_ids_that_the_instance_table_lacks_are_listed() -> None:
    parts = rigged_parts()

    def measure(specs: Mapping[str, ArraySpec]) -> Arrays:
        return {name: np.full_like(array, 99 * (name == "ids")) for name, array in empty_arrays(specs).items()}

    parts.measure = measure
    found = findings(parts.write())
    assert "sensor scan, step 0: shows ids [99] that the instance table does not have" in found
    assert len(found) == 12


def test_a_sample_decodes_some_measurements_and_the_last_one() -> None:
    parts, seen = rigged_parts(), iter(range(12))

    def measure(specs: Mapping[str, ArraySpec]) -> Arrays:
        step = next(seen)
        return {
            name: np.full_like(array, 99 * (name == "ids" and step in {1, 11}))
            for name, array in empty_arrays(specs).items()
        }

    parts.measure = measure
    assert [text.partition(":")[0] for text in findings(parts.write(), scope=Scope.SAMPLE)] == ["sensor scan, step 11"]


def test_exchanged_measurements_are_found_by_their_digest() -> None:
    parts, steps = rigged_parts(), iter(range(12))

    def measure(specs: Mapping[str, ArraySpec]) -> Arrays:
        step = next(steps)
        return {name: np.full_like(array, name == "ranges" and step) for name, array in empty_arrays(specs).items()}

    parts.measure = measure
    members = [f"sensors/scan/ranges/{t:06d}.npy.zst" for t in (3, 4)]
    swapped = dict(zip(members, reversed(members), strict=True))
    buffer = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(parts.write())) as found, ContainerWriter(buffer) as out:
        for name in found.namelist():
            out.add(name, found.read(swapped.get(name, name)))
    (finding,) = findings(buffer.getvalue())
    assert finding.startswith("sensor scan decodes to digest ")


def test_missing_measurements_and_the_wrong_format_of_a_bundle_with_a_rig_are_found() -> None:
    plain = parts_for()
    meta = plain.meta.model_copy(update={"job": job_for(view=ViewSettings(rig=RIG))})
    bundle = BundleReader(io.BytesIO(plain.write()))
    bundle.__dict__["meta"] = meta
    found = validate(bundle)
    assert "the bundle lacks measurements, but its job has the rig 'one'" in found
    assert f"the bundle has format {FORMAT_WITHOUT_RIG}, but bundles of its job have format 3" in found
    assert "the bundle has digests of the sensors [], but its rig has the sensors ['scan']" in found
