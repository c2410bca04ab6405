"""Checks the first frame and pose of a bundle against the conditions of its job on the start. Reads no file."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from schemas.bundle import EpisodeArrays
from schemas.episode import EpisodeMeta
from schemas.instruction.start_view import start_view_findings
from schemas.measure import yaw_of

BEARING_SLACK_RAD = 1e-5
"""Tolerance between directions of float64 and float32 poses, radians."""


def start_findings(
    meta: EpisodeMeta, arrays: EpisodeArrays, ids: NDArray[np.uint16], depth: NDArray[np.float32]
) -> list[str]:
    """Returns the conditions of the job on the image and heading at the start that the episode does not meet.

    The coordinator computes the conditions from the compiled scene and leases them with the job; a worker that changes
    them is refused, because its job differs from the leased one.

    Args:
        meta: metadata of the episode.
        arrays: arrays of the episode.
        ids: (S, S) instance ids of frame 0.
        depth: (S, S) depth of frame 0, metres.
    """
    view = meta.job.start_view
    if view is None:
        return []
    x, y = arrays.poses[0, :2].astype(np.float64).tolist()
    towards = math.atan2(meta.target_centroid_m[1] - y, meta.target_centroid_m[0] - x)
    off = abs(math.remainder(towards - float(yaw_of(arrays.poses[:1])[0]), 2 * math.pi))
    least_off = max(0.0, off - BEARING_SLACK_RAD)
    job, target = meta.job, meta.target_instance_id
    found = start_view_findings(view, target, least_off, ids, depth, job.camera, job.gains.min_mask_px)
    return [f"start: {finding}" for finding in found]
