"""Validates the measurements of a rig in a bundle: arrays, bounds, instance ids and digests.

Decodes one measurement at a time. Does not render, so it cannot compare measurements with the scene.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from coordinator.validation.frames import MAX_FINDINGS
from schemas.bundle import BundleReader
from schemas.episode import FORMAT_WITHOUT_RIG, format_of
from schemas.errors import InvalidBundle
from schemas.rig import Sensor
from schemas.rig.measurements import MeasurementDigest, measurements_of

_IDS = "ids"


def rig_findings(bundle: BundleReader) -> list[str]:
    """Returns contradictions between the job's rig, the format, the digests and the presence of measurements."""
    meta, rig = bundle.meta, bundle.meta.job.view.rig
    wanted = [] if rig is None else [sensor.name for sensor in rig.sensors]
    findings = []
    if bundle.has_sensors != (rig is not None):
        of_job = "no rig" if rig is None else f"the rig {rig.name!r}"
        findings.append(f"the bundle {'has' if bundle.has_sensors else 'lacks'} measurements, but its job has {of_job}")
    if (meta.format > FORMAT_WITHOUT_RIG) != (format_of(meta.job) > FORMAT_WITHOUT_RIG):
        findings.append(
            f"the bundle has format {meta.format}, but bundles of its job have format {format_of(meta.job)}"
        )
    if list(meta.sensor_digests) != wanted:
        findings.append(
            f"the bundle has digests of the sensors {list(meta.sensor_digests)}, but its rig has the sensors {wanted}"
        )
    return findings


def survey_measurements(bundle: BundleReader, stride: int = 1) -> list[str]:
    """Decodes and validates the measurements of a bundle without `rig_findings`.

    Args:
        bundle: open bundle.
        stride: distance between two decoded measurements of a sensor; the last one is always decoded. The digest
            of a sensor is compared only if all its measurements are decoded.
    """
    rig = bundle.meta.job.view.rig
    known = np.zeros(1 << 16, dtype=bool)
    known[[0, *(instance.id for instance in bundle.meta.instances)]] = True
    findings = [text for sensor in (rig.sensors if rig else ()) for text in _survey(bundle, sensor, stride, known)]
    rest = len(findings) - MAX_FINDINGS
    return findings if rest <= 0 else [*findings[:MAX_FINDINGS], f"and {rest} more findings about sensors"]


def _survey(bundle: BundleReader, sensor: Sensor, stride: int, known: NDArray[np.bool_]) -> list[str]:
    findings: list[str] = []
    digest = MeasurementDigest()
    steps = [t for t, _ in measurements_of(sensor, bundle.length, bundle.control_hz)]
    chosen = sorted({*range(0, len(steps), stride), len(steps) - 1})
    for number in chosen:
        where = f"sensor {sensor.name}" if steps[number] is None else f"sensor {sensor.name}, step {steps[number]}"
        try:
            arrays = bundle.measurement(sensor, steps[number])
        except InvalidBundle as error:
            findings += [f"{where}: {finding}" for finding in error.findings]
            continue
        findings += [f"{where}: {text}" for text in _strange_ids(arrays, known)]
        digest.add(arrays.values())
    recorded = bundle.meta.sensor_digests[sensor.name]
    if len(chosen) == len(steps) and not findings and digest.hexdigest() != recorded:
        findings.append(f"sensor {sensor.name} decodes to digest {digest.hexdigest()}, meta.json says {recorded}")
    return findings


def _strange_ids(arrays: dict[str, NDArray[Any]], known: NDArray[np.bool_]) -> list[str]:
    if _IDS not in arrays or known[arrays[_IDS]].all():
        return []
    strange = np.unique(arrays[_IDS][~known[arrays[_IDS]]])[:5].tolist()
    return [f"shows ids {strange} that the instance table does not have"]
