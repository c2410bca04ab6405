"""Runs attempts in a scene package, in this process, until one succeeds."""

from __future__ import annotations

import hashlib
import io
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from schemas.bundle import BundleReader
from schemas.job import Job
from workers.sim.attempt import Success, run_attempt
from workers.sim.context import SimulationContext


def write_package(folder: Path, data: bytes) -> Path:
    """Writes a scene package and returns its path."""
    path = folder / "scene.scene"
    path.write_bytes(data)
    return path


@contextmanager
def loaded_renderer(package: Path) -> Iterator[SimulationContext]:
    """Yields a renderer with a scene package."""
    with SimulationContext() as renderer:
        renderer.load(package, hashlib.sha256(package.read_bytes()).hexdigest())
        yield renderer


def first_success(jobs: Iterable[Job], renderer: SimulationContext) -> tuple[Job, BundleReader]:
    """Returns the first job whose attempt succeeds, and its bundle."""
    for job in jobs:
        file = io.BytesIO()
        if isinstance(run_attempt(job, renderer, file, "host-1", lambda _: None), Success):
            return job, BundleReader(file)
    raise AssertionError("no attempt succeeds")
