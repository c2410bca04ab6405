"""Experts: controllers that know the goal and produce the demonstrations, with a registry and a common protocol."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType

from schemas.errors import UsageError
from schemas.job import Job
from schemas.terms import ExpertName
from workers.experts.base import Expert, ExpertObservation
from workers.experts.planner import PlannerExpert
from workers.experts.proportional import ProportionalExpert, centroid_speed, depth_speed, literal_speed
from workers.experts.standing import StandingExpert

__all__ = ["EXPERTS", "Expert", "ExpertObservation", "make_expert", "require_expert"]

EXPERTS: Mapping[ExpertName, Callable[[Job], Expert]] = MappingProxyType(
    {
        ExpertName.PROPORTIONAL: lambda job: ProportionalExpert(job, centroid_speed),
        ExpertName.DEPTH: lambda job: ProportionalExpert(job, depth_speed),
        ExpertName.PAPER_LITERAL: lambda job: ProportionalExpert(job, literal_speed),
        ExpertName.PLANNER: PlannerExpert,
    }
)
"""Constructor of each expert, by name."""


def make_expert(job: Job) -> Expert:
    """Returns the expert of a job.

    Raises:
        UsageError: this version does not have the expert.
    """
    require_expert(job.expert)
    if job.is_false_premise:
        return StandingExpert()
    return EXPERTS[job.expert](job)


def require_expert(name: ExpertName) -> None:
    """Checks that this version has an expert.

    Raises:
        UsageError: this version does not have the expert.
    """
    if name not in EXPERTS:
        known = ", ".join(EXPERTS)
        raise UsageError(f"expert {name} is not available in this version; choose another with --expert: {known}")
