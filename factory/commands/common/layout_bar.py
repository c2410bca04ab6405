"""Progress bar of the builds of layouts. Builds nothing."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

import click
from rich.progress import TaskID

from factory.commands.common.bars import Bars
from factory.runs.layouts import BuiltLayout, LayoutBuilds


@contextmanager
def building_layouts(processes: int, stop: threading.Event) -> Iterator[LayoutBuilds]:
    """Yields settings for builds of layouts. The builds show a progress bar, and print why they do not use a seed."""
    with _LayoutBar() as bar:
        yield LayoutBuilds(processes, stop, bar.tell)


class _LayoutBar(Bars):
    _task: TaskID | None = None

    def tell(self, built: BuiltLayout, total: int) -> None:
        """Updates the bar, which appears with the first layout."""
        for line in built.refused:
            click.echo(f"note: {built.name} does not use {line}", err=True)
        if self._task is None:
            self._task = self.add_task("layouts", total=total)
        self.update(self._task, advance=1, note=built.name)
