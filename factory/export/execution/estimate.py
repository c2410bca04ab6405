"""Estimates size and duration of an export from one episode of median length. Keeps no files."""

from __future__ import annotations

import dataclasses
import tempfile
import time
from pathlib import Path

import numpy as np

from factory.dataset.reader import Dataset
from factory.export.execution.export_run import ExportOrder, plan_manifest, run_export
from factory.export.execution.manifest import require_same_export
from factory.export.registry import find_exporter, require_packages
from schemas.base import Model
from schemas.errors import WorldError
from schemas.storage.disk import free_bytes

_TRIES = 3


class ExportEstimate(Model):
    """Estimate of an export from one sample episode."""

    dataset: str
    format: str
    out: str
    episodes: int
    frames: int
    """Expected number of frames in the export."""
    bytes: int
    """Expected size of the export, bytes."""
    peak_bytes: int
    """Expected peak disk use, bytes. If the format joins pieces, both the pieces and the joined files need space."""
    seconds: float
    """Expected wall time with `workers` processes on as many cores, seconds."""
    workers: int
    free_bytes: int
    """Free space on the disk of the export, bytes."""
    fits: bool
    """Whether `peak_bytes` fits into `free_bytes`."""
    sample: str
    """Id of the sample episode."""
    sample_frames: int
    sample_bytes: int
    sample_seconds: float


def estimate_export(order: ExportOrder) -> ExportEstimate:
    """Exports one episode to a temporary directory and extrapolates.

    Raises:
        UsageError: the options do not fit the format or the dataset, or no episode is selected.
        WorldError: the export is not possible, or no episode could be read.
    """
    exporter = find_exporter(order.format)
    require_packages(exporter)
    dataset, manifest = plan_manifest(order, exporter)
    require_same_export(order.out, manifest)
    sample, frames, size, seconds = _measure(order, dataset)
    steps = np.asarray(dataset.column("num_steps").to_pylist(), np.float64)
    scale = float(steps.sum()) / float(steps[dataset.column("episode_id").to_pylist().index(sample)])
    peak = round(size * scale * (2 if exporter.assembles else 1))
    free = free_bytes(order.out)
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
    """Exports the first readable episode near the median length; returns its id, frames, bytes and seconds."""
    error_text = ""
    for name in _by_nearness_to_the_median(dataset)[:_TRIES]:
        with tempfile.TemporaryDirectory(prefix="export-") as place:
            trial = dataclasses.replace(order, out=Path(place) / "out", splits=(), episodes=(name,), workers=0)
            started = time.monotonic()
            try:
                report = run_export(trial)
            except WorldError as error:
                error_text = str(error)
                continue
            return name, report.frames, report.bytes, time.monotonic() - started
    raise WorldError(f"{order.root}: {_TRIES} sample episodes could not be exported: {error_text}")


def _by_nearness_to_the_median(dataset: Dataset) -> list[str]:
    steps = np.asarray(dataset.column("num_steps").to_pylist(), np.float64)
    order = np.argsort(np.abs(steps - np.median(steps)), kind="stable")
    names: list[str] = dataset.column("episode_id").take(order).to_pylist()
    return names
