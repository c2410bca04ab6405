"""What the coordinator does with a bundle: validating and archiving, timed in this process on one real bundle.

Neither ledger nor network takes part, nor the sandbox: its child runs the same function.
"""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path
from typing import BinaryIO

from coordinator.archive.opening import open_archive
from coordinator.validation.validate import validate
from factory.bench.model import StageCost
from factory.bench.stage_times import StageClock, StageTimes, stage_costs
from schemas.bundle import BundleReader
from schemas.errors import InvalidBundle

__all__ = ["time_delivery"]


def time_delivery(file: BinaryIO, repeats: int) -> tuple[StageCost, ...]:
    """Validates and archives the bundle in `file` so many times and returns the cost of both stages a frame.

    Raises:
        InvalidBundle: it may not enter a dataset, so that its validation is no measure.
    """
    return stage_costs([_deliver(file) for _ in range(repeats)])


def _deliver(file: BinaryIO) -> tuple[int, StageTimes]:
    watch = StageClock()
    with tempfile.TemporaryDirectory(prefix="bench-") as folder, open_archive(Path(folder)) as archive:
        watch.start()
        bundle = BundleReader(file)
        findings = validate(bundle)
        watch("validate")
        index = bundle.meta.job.index
        file.seek(0)
        with archive.stage(index) as staged:
            shutil.copyfileobj(file, staged, 1 << 20)
            archive.publish(staged, index)
        watch("archive")
    if findings:
        raise InvalidBundle("the benchmark's own bundle is refused", findings)
    return bundle.length, watch.take()
