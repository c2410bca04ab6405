"""Type of the callback that a loop calls at the end of each stage, for profiling."""

from __future__ import annotations

from collections.abc import Callable

StageTimer = Callable[[str], None]
"""Called with the name of a stage at its end; the time since the end of the previous stage belongs to that stage."""


def no_stage_timer(stage: str) -> None:
    """Ignores the end of a stage."""
