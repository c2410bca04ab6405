"""How large an export will be and how long it will take: measured on one episode of middling length. Keeps nothing."""

from __future__ import annotations

import dataclasses
import shutil
import tempfile
import time
from pathlib import Path

import numpy as np

from factory.dataset.reader import Dataset
from factory.export.execution.manifest import require_ours
from factory.export.execution.run import ExportOrder, plan_manifest, run_export
from factory.export.registry import find_exporter, require_packages
from schemas.base import Model
from schemas.errors import WorldError
from schemas.storage.disk import translated

__all__ = ["ExportEstimate", "estimate_export"]

_TRIES = 3


class ExportEstimate(Model):
    """What an export will be, as far as one episode can tell."""

    dataset: str
    format: str
    out: str
    episodes: int
    frames: int
    """Expected in the export."""
    bytes: int
    """Expected size of the export."""
    peak_bytes: int
    """Expected on disk while it is made; formats that join episodes hold them twice for a while."""
    seconds: float
    """Expected wall time with `workers` processes that have a core each."""
    workers: int
    free_bytes: int
    """On the disk of the export now."""
    fits: bool
    """Whether the peak does."""
    sample: str
    """The episode that was measured."""
    sample_frames: int
    sample_bytes: int
    sample_seconds: float


def estimate_export(order: ExportOrder) -> ExportEstimate:
    """Exports one episode to a temporary place and multiplies.

    Raises:
        UsageError: the options fit neither format nor dataset, or nothing is asked for.
        WorldError: what a real export would be refused for; or no episode could be read.
    """
    exporter = find_exporter(order.format)
    require_packages(exporter)
    dataset, manifest = plan_manifest(order, exporter)
    require_ours(order.out, manifest)
    sample, frames, size, seconds = _measure(order, dataset)
    steps = np.asarray(dataset.metadata["num_steps"].to_pylist(), np.float64)
    scale = float(steps.sum()) / float(steps[dataset.metadata["episode_id"].to_pylist().index(sample)])
    peak = round(size * scale * (2 if exporter.assembles else 1))
    free = _free_bytes(order.out)
    return ExportEstimate(
        dataset=str(order.root),
        format=exporter.name,
        out=str(order.out),
        episodes=len(dataset),
        frames=round(frames * scale),
        bytes=round(size * scale),
        peak_bytes=peak,
        seconds=seconds * scale / max(1, order.workers),
        workers=max(1, order.workers),
        free_bytes=free,
        fits=peak <= free,
        sample=sample,
        sample_frames=frames,
        sample_bytes=size,
        sample_seconds=seconds,
    )


def _measure(order: ExportOrder, dataset: Dataset) -> tuple[str, int, int, float]:
    """Returns id, frames, bytes and seconds of the first episode around the middle that can be read."""
    said = ""
    for name in _by_nearness_to_the_median(dataset)[:_TRIES]:
        with tempfile.TemporaryDirectory(prefix="export-") as place:
            trial = dataclasses.replace(order, out=Path(place) / "out", splits=(), episodes=(name,), workers=0)
            begun = time.monotonic()
            try:
                report = run_export(trial)
            except WorldError as error:
                said = str(error)
                continue
            return name, report.frames, report.bytes, time.monotonic() - begun
    raise WorldError(f"{order.root}: {_TRIES} sample episodes could not be exported: {said}")


def _by_nearness_to_the_median(dataset: Dataset) -> list[str]:
    steps = np.asarray(dataset.metadata["num_steps"].to_pylist(), np.float64)
    order = np.argsort(np.abs(steps - np.median(steps)), kind="stable")
    return [str(dataset.metadata["episode_id"][int(position)].as_py()) for position in order]


def _free_bytes(out: Path) -> int:
    there = next(place for place in (out.absolute(), *out.absolute().parents) if place.exists())
    with translated("ask the free space of", there):
        return shutil.disk_usage(there).free
