"""Benchmarks the delivery of a bundle: validation and archiving of one real bundle in this process.

Does not use the ledger, the network or the sandbox, whose child process runs the same function.
"""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path
from typing import BinaryIO

from coordinator.archive.opening import open_archive
from coordinator.validation.validate import validate
from factory.bench.model import StageCost
from factory.bench.stage_times import StageRecorder, StageTimes, stage_costs
from schemas.bundle import BundleReader
from schemas.errors import InvalidBundle

__all__ = ["time_delivery"]


def time_delivery(file: BinaryIO, repeats: int) -> tuple[StageCost, ...]:
    """Validates and archives the bundle in `file` `repeats` times and returns the cost of both stages per frame.

    Raises:
        InvalidBundle: The bundle is not valid, so that its validation time would not be representative.
    """
    return stage_costs([_deliver(file) for _ in range(repeats)])


def _deliver(file: BinaryIO) -> tuple[int, StageTimes]:
    recorder = StageRecorder()
    with tempfile.TemporaryDirectory(prefix="bench-") as folder, open_archive(Path(folder)) as archive:
        recorder.start()
        bundle = BundleReader(file)
        findings = validate(bundle)
        recorder("validate")
        index = bundle.meta.job.index
        file.seek(0)
        with archive.stage(index) as staged:
            shutil.copyfileobj(file, staged, 1 << 20)
            archive.publish(staged, index)
        recorder("archive")
    if findings:
        raise InvalidBundle("the bundle of the benchmark is invalid", findings)
    return bundle.length, recorder.take()
