"""Shows the progress of a benchmark, and provides its plan and a folder for its files."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from factory.support.terminal import Bars

SAMPLE_PLAN = "demo"
"""Plan of the benchmarks that need a few episodes of each scene."""


@contextmanager
def temporary_folder() -> Iterator[Path]:
    """Yields a folder that is deleted at the end."""
    with tempfile.TemporaryDirectory(prefix="bench-") as folder:
        yield Path(folder)


@contextmanager
def progress_bar(name: str, total: int) -> Iterator[Callable[[], None]]:
    """Shows a progress bar; yields the function that advances it by one."""
    with Bars(refresh_per_second=1) as bar:
        task = bar.add_task(f"bench {name}", total=total)
        yield lambda: bar.advance(task)
