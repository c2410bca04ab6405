"""Builds the result of an episode whose driver process was killed or died, from its last shared status. Pure."""

from __future__ import annotations

from factory.eval.driving.policy import PolicyFault
from factory.eval.driving.rollout import progresses, request_fields
from factory.eval.models.messages import EvalTask
from factory.eval.models.result import EpisodeResult, EvalEnd
from factory.eval.process.shared_status import DriverStatus

__all__ = ["interrupted_result"]


def interrupted_result(task: EvalTask, detail: str, fault: PolicyFault, state: DriverStatus) -> EpisodeResult:
    """Returns the failed result of an episode whose driver process was killed or died.

    Args:
        task: Task of the episode.
        detail: Description of the end.
        fault: Kind of the policy failure.
        state: Last shared status of the driver process.
    """
    spec = task.request.spec
    start_m = state.start_m or spec.spawn_dist_m
    now_m, least_m = (state.now_m, state.least_m) if state.start_m else (start_m, start_m)
    nothing = None if spec.geodesic_m is None else 0.0
    return EpisodeResult(
        **request_fields(task),
        end=EvalEnd(fault),
        detail=detail,
        success=False,
        any_instance=False,
        num_steps=state.steps,
        spawn_dist_m=start_m,
        trajectory_length_m=state.driven_m,
        final_ne_m=now_m,
        min_ne_m=least_m,
        spl=nothing,
        soft_spl=nothing,
        **progresses(start_m, now_m, least_m, task.setup.settings.task),
        contact_steps=state.contact_steps,
        clipped_actions=0,
        act_ms=0.0,
        seconds=0.0,
        track=(spec.spawn_pose,),
    )
