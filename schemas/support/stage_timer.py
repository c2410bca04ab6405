"""The hook by which a loop says which stage it has just ended; whoever listens holds the watch. Measures nothing."""

from __future__ import annotations

from collections.abc import Callable

__all__ = ["StageTimer", "no_stage_timer"]

StageTimer = Callable[[str], None]
"""Is told the name of a stage at its end; what passed since the end of the stage before it belongs to that stage."""


def no_stage_timer(stage: str) -> None:
    """Listens to nothing."""
