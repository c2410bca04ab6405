"""Renders frames of a driven trajectory into a bundle: all for a frames recording, samples for a states recording.

Does not simulate the drive. A frame is a function of scene, camera and pose, so it may be rendered at any time after
its step.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from schemas.bundle import BundleWriter
from schemas.job import Job
from schemas.measure import target_in_view
from workers.geometry.pose import Pose
from workers.render import Renderer


def add_frames(
    writer: BundleWriter,
    renderer: Renderer,
    job: Job,
    poses: NDArray[np.float64],
    instance_id: int,
    on_frame: Callable[[int], None],
) -> int:
    """Renders and stores the frames of all poses; returns the number of frames that show the target.

    Args:
        writer: bundle without frames.
        renderer: renderer with the scene loaded.
        job: job, with the smallest mask of a visible target.
        poses: (T, 7) poses of base_link: x, y, z, qw, qx, qy, qz.
        instance_id: id of the target.
        on_frame: called after each frame with the number of frames.
    """
    visible = 0
    for t, row in enumerate(poses, 1):
        frame = renderer.render(Pose.of(row))
        visible += target_in_view(frame.ids, instance_id, job.gains.min_mask_px)
        writer.add_frame(frame.rgb, frame.depth, frame.ids)
        on_frame(t)
    return visible


def add_sampled_digests(writer: BundleWriter, renderer: Renderer, job: Job, poses: NDArray[np.float64]) -> None:
    """Renders the sampled frames of a states recording and adds their digests.

    Args:
        writer: bundle without frames.
        renderer: renderer with the scene loaded.
        job: job, with the sampled steps.
        poses: (T, 7) poses of base_link: x, y, z, qw, qx, qy, qz.
    """
    for t in job.sampled_steps(len(poses)):
        frame = renderer.render(Pose.of(poses[t]))
        writer.add_digest(frame.rgb, frame.depth, frame.ids)
