"""One row of `attempts.parquet`: an attempt that brought no episode. A model; reads and writes nothing."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated

from pydantic import Field

from schemas.base import Model, Name, NonNegative
from schemas.terms import Split, Tier

__all__ = ["FailedAttempt"]


class FailedAttempt(Model):
    """An attempt that brought no episode (STYLE 18)."""

    episode_id: Name
    draw: Annotated[int, Field(ge=0)]
    attempt: Annotated[int, Field(ge=1)]
    scene: Name
    spawn_tier: Tier
    split: Split
    target_category: Name
    target_id: Name
    reason: str
    """A fail reason of `schemas.terms`, or how the lease ended."""
    detail: str = ""
    """Measured values, in words."""
    steps: Annotated[int, Field(ge=0)] = 0
    """Simulated before the end."""
    seconds: NonNegative = 0.0
    """Wall time spent."""
    worker: str = ""
    at: datetime
