"""Progress bars on stderr; where no terminal shows them, a line a minute. The only user of rich's `Progress`."""

from __future__ import annotations

import time
from typing import Any

from rich.console import Console
from rich.progress import Progress, ProgressColumn, TaskID

from factory.cli.output import stderr

__all__ = ["Bars"]

_PAUSE_S = 60.0


class Bars(Progress):
    """Rich's bars, which a log file would show only once all is over: hours later, where work runs by night.

    Args:
        columns: rich's own when none is given.
        transient: leave nothing behind.
        refresh_per_second: how often a terminal is redrawn.
        console: where to.
        pause_s: least time between two lines where there is no terminal, seconds.
    """

    def __init__(
        self,
        *columns: str | ProgressColumn,
        transient: bool = False,
        refresh_per_second: float = 10.0,
        console: Console = stderr,
        pause_s: float = _PAUSE_S,
    ) -> None:
        super().__init__(*columns, console=console, transient=transient, refresh_per_second=refresh_per_second)
        self._pause_s = pause_s
        self._said = time.monotonic()

    def update(self, task_id: TaskID, **changes: Any) -> None:
        """Changes a task as rich does, and says so where nobody sees its bar."""
        super().update(task_id, **changes)
        self._say()

    def advance(self, task_id: TaskID, advance: float = 1) -> None:
        """Moves a task on as rich does, and says so where nobody sees its bar."""
        super().advance(task_id, advance)
        self._say()

    def _say(self) -> None:
        now = time.monotonic()
        if self.console.is_terminal or now - self._said < self._pause_s:
            return
        self._said = now
        under_way = [task for task in self.tasks if task.started and not task.finished and task.total]
        if under_way:
            self.console.print(self.make_tasks_table(under_way))
