"""Validates a whole bundle and lists all violations. Does not archive the bundle."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from coordinator.validation.frames import survey_frames
from coordinator.validation.job import job_findings, table_findings, target_findings
from coordinator.validation.messages import Scope
from coordinator.validation.motion import motion_findings
from coordinator.validation.rollout import arrival_findings, rollout_findings, route_findings, visibility_findings
from coordinator.validation.sensors import rig_findings, survey_measurements
from coordinator.validation.start import choice_findings, start_findings
from schemas.bundle import BundleReader
from schemas.encoding.arrays import POSES
from schemas.episode import EpisodeMeta
from schemas.job import Job
from schemas.scene import Target
from schemas.terms import Recording

_STRIDE = 8
"""With `Scope.SAMPLE`, one in this many frames and measurements is decoded
(docs/design/protocol.md#sampled-validation-on-one-machine)."""


def validate(
    bundle: BundleReader,
    job: Job | None = None,
    candidates: Sequence[Target] = (),
    on_frame: Callable[[int], None] = lambda _t: None,
    scope: Scope = Scope.ALL,
) -> list[str]:
    """Decodes a bundle and returns all violations, with values and units.

    The frame digests of a states recording are not compared with frames, because this process does not render;
    `factory verify --render` does.

    Args:
        bundle: open bundle; opening it has checked members, shapes, dtypes and bounds of the arrays.
        job: leased job; `None` validates the bundle against its recorded job.
        candidates: targets of the compiled scene that the episode may have, see `candidates_of`; if empty, they are
            not compared.
        on_frame: progress callback with the number of each processed frame.
        scope: part of the bundle that is read. `SAMPLE` decodes `sampled_frames`, for bundles that this user's workers
            wrote on this machine; `CLAIM` decodes no frame and does not check the drive.

    Returns:
        The violations; empty if the bundle is valid.
    """
    meta, arrays, task = bundle.meta, bundle.arrays, bundle.meta.job.task
    findings = job_findings(meta, job) if job is not None else []
    findings += table_findings(meta) + choice_findings(meta)
    findings += _format_findings(bundle)
    findings += target_findings(meta, candidates) if candidates else []
    if scope is Scope.CLAIM:
        return findings + _digest_findings(bundle)
    of_rig, is_sample = rig_findings(bundle), scope is Scope.SAMPLE
    findings += of_rig or survey_measurements(bundle, _STRIDE if is_sample else 1)
    findings += rollout_findings(meta, arrays)
    findings += route_findings(meta, arrays)
    findings += motion_findings(arrays, meta.job.robot, task.control_hz, meta.rollout.collision_count)
    if bundle.has_frames:
        steps = sampled_frames(meta) if is_sample else range(bundle.length)
        survey = survey_frames(bundle, steps, on_frame)
        findings += survey.findings
        if len(survey.digests) < len(steps):
            return findings  # a frame cannot be decoded, but the remaining checks need all selected frames
        findings += visibility_findings(meta, survey.target_pixels)
        findings += arrival_findings(meta, survey.target_pixels[bundle.length - 1])
        findings += start_findings(meta, arrays, ids=bundle.ids(0), depth=bundle.depth(0), candidates=candidates)
    return findings + _digest_findings(bundle)


def sampled_frames(meta: EpisodeMeta) -> list[int]:
    """Returns the steps of the first frame, of every `_STRIDE`-th frame and of the last frame.

    The content digest determines which step the stride starts with, so the steps differ between episodes.
    """
    last = meta.rollout.num_steps - 1
    return sorted({0, *range(int(meta.content_digest, 16) % _STRIDE, last, _STRIDE), last})


def _digest_findings(bundle: BundleReader) -> list[str]:
    digest, recorded = bundle.content_digest(bundle.meta.frame_digests), bundle.meta.content_digest
    return [] if digest == recorded else [f"content digest {digest}, meta.json says {recorded}"]


def _format_findings(bundle: BundleReader) -> list[str]:
    meta, record = bundle.meta, bundle.meta.job.record
    wanted = POSES.former_dtype if meta.format < 2 else POSES.dtype
    findings = []
    if bundle.pose_dtype != wanted:
        findings.append(f"poses.npy has {bundle.pose_dtype}; bundles of format {meta.format} have {np.dtype(wanted)}")
    if bundle.has_frames != (record is Recording.FRAMES):
        findings.append(f"the bundle {'has' if bundle.has_frames else 'lacks'} frames, but its job records {record}")
    if (bundle.arrays.corrections is None) != (meta.job.correction is None):
        findings.append(f"the bundle {'lacks' if meta.job.correction else 'has'} corrections, contrary to its job")
    is_counted = record is Recording.FRAMES or meta.job.expert.uses_images
    if (meta.rollout.steps_visible is not None) != is_counted:
        seen, expert = meta.rollout.steps_visible, meta.job.expert
        wanted_count = "a number" if is_counted else "null"
        findings.append(
            f"steps_visible is {seen}, not {wanted_count}, in a recording of {record} by the {expert} expert"
        )
    return findings
