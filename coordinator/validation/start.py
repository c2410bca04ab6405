"""Checks the first frame and pose of a bundle against the conditions of its job on the start. Reads no file."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from schemas.bundle import EpisodeArrays
from schemas.episode import EpisodeMeta
from schemas.exchangeable import exchangeable_targets
from schemas.instruction.referents import ids_in_view
from schemas.instruction.start_view import TargetChoice, start_view_findings
from schemas.scene import Target
from schemas.support.geometry import yaw_of

BEARING_SLACK_RAD = 1e-5
"""Tolerance between directions of float64 and float32 poses, radians."""


def start_findings(
    meta: EpisodeMeta,
    arrays: EpisodeArrays,
    ids: NDArray[np.uint16],
    depth: NDArray[np.float32],
    candidates: Sequence[Target] = (),
) -> list[str]:
    """Returns the start conditions of the job, on image and heading, that the episode does not meet.

    The coordinator computes the conditions from the compiled scene and sends them with the leased job. If a worker
    changes them, its bundle is refused, because the job of the bundle differs from the leased one.

    Args:
        meta: metadata of the episode.
        arrays: arrays of the episode.
        ids: (S, S) instance ids of frame 0.
        depth: (S, S) depth of frame 0, metres.
        candidates: targets that the episode may have, of the compiled scene; empty if the scene cannot be read.
    """
    view, job, target = meta.job.start_view, meta.job, meta.target_instance_id
    if view is None:
        return []
    if view.choice is not None:
        findings = _choice_findings(meta, view.choice, ids, candidates)
        return [f"start: {finding}" for finding in findings]
    x, y = arrays.poses[0, :2].astype(np.float64).tolist()
    towards = math.atan2(meta.target_centroid_m[1] - y, meta.target_centroid_m[0] - x)
    off = abs(math.remainder(towards - float(yaw_of(arrays.poses[:1])[0]), 2 * math.pi))
    least_off = max(0.0, off - BEARING_SLACK_RAD)
    findings = start_view_findings(
        view, target, bearing_rad=least_off, ids=ids, depth=depth, camera=job.camera, min_pixels=job.gains.min_mask_px
    )
    return [f"start: {finding}" for finding in findings]


def choice_findings(meta: EpisodeMeta) -> list[str]:
    """Returns the contradictions between the target of an episode and the draw of its job; reads no image."""
    view, choices = meta.job.start_view, meta.choices
    if view is None or view.choice is None:
        return ["choices are recorded, but the plan of the job names the target"] if choices else []
    findings = []
    if len(choices) <= view.least_same_category:
        findings.append(
            f"{len(choices)} objects could be the target, the plan requires at least {view.least_same_category + 1}"
        )
    stray = sorted(set(choices).difference(view.choice.among))
    if stray or list(choices) != sorted(set(choices)):
        findings.append(
            f"choices {list(choices)}: the job permits distinct ids of {list(view.choice.among)} in ascending order"
        )
    if choices and meta.target_instance_id != view.choice.of(choices):
        findings.append(f"the target is object {meta.target_instance_id}, the job selects {view.choice.of(choices)}")
    return findings


def _choice_findings(
    meta: EpisodeMeta, choice: TargetChoice, ids: NDArray[np.uint16], candidates: Sequence[Target]
) -> list[str]:
    """Returns how the recorded choices, the objects that could be the target, contradict the first frame."""
    if {each.instance_id for each in candidates} != set(choice.among):
        hidden = sorted(set(meta.choices).difference(ids_in_view(ids, meta.job.gains.min_mask_px)))
        return [f"objects {hidden} are not in view, but recorded as possible targets"] if hidden else []
    there = exchangeable_targets(meta.job, candidates, meta.rollout.spawn_pose, ids)
    measured = tuple(each.instance_id for each in there)
    if measured == meta.choices:
        return []
    return [f"objects {list(measured)} could be the target in the first frame, but choices are {list(meta.choices)}"]
