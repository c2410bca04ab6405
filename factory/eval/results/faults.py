"""Where a policy failed as a program: how often, in which way, and what it said first. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

from pydantic import Field

from factory.eval.models.result import EpisodeResult, EvalEnd
from schemas.base import Model, Name

__all__ = ["FaultCount", "faults_of"]


class FaultCount(Model):
    """All drives of a policy that it ended by failing in one way, whatever words it was given."""

    end: EvalEnd
    drives: Annotated[int, Field(ge=1)]
    of: Annotated[int, Field(ge=1)]
    """Drives of the policy, other words included."""
    first: Name
    """The episode in which it happened first."""
    detail: str
    """What was said there, with its place in the code where it has one."""


def faults_of(results: Sequence[EpisodeResult]) -> tuple[FaultCount, ...]:
    """Returns the ways in which a policy failed, the most frequent first.

    Args:
        results: all drives of the policy, in order.
    """
    rows: dict[EvalEnd, list[EpisodeResult]] = {}
    for row in results:
        if row.end.is_of_the_policy:
            rows.setdefault(row.end, []).append(row)
    faults = (
        FaultCount(end=end, drives=len(found), of=len(results), first=found[0].spec_id, detail=found[0].detail)
        for end, found in rows.items()
    )
    return tuple(sorted(faults, key=lambda fault: (-fault.drives, fault.end)))
