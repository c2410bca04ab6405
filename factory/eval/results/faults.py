"""Summarises policy failures, such as exceptions and timeouts: number, kind and first message. Pure functions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

from pydantic import Field

from factory.eval.models.result import EpisodeResult, EvalEnd
from schemas.base import Model, Name


class FaultCount(Model):
    """Episodes of a policy that ended with one kind of policy failure, under all instruction variants."""

    end: EvalEnd
    drives: Annotated[int, Field(ge=1)]
    of: Annotated[int, Field(ge=1)]
    """Number of episodes of the policy under all instruction variants."""
    first: Name
    """First episode with this failure."""
    detail: str
    """Message of that failure, with file and line if known."""


def faults_of(results: Sequence[EpisodeResult]) -> tuple[FaultCount, ...]:
    """Returns the kinds of failure of a policy, the most frequent first.

    Args:
        results: All results of the policy, in order.
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
