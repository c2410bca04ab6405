"""Results of evaluation tasks from workers: a bundle of one member with the result and the note of its policy.

Reads and writes open files; limits sizes before allocating memory. The validator checks that a result matches its
request, is consistent, and respects the limits of the robot; it does not simulate.
"""

from __future__ import annotations

import hashlib
import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, BinaryIO

from pydantic import Field, ValidationError

from coordinator.validation.messages import Scope, ValidationTask, check_each
from factory.eval.driving import measure
from factory.eval.driving.rollout import TRACK_HZ, progresses, request_fields
from factory.eval.models.messages import EvalTask
from factory.eval.models.result import EpisodeResult
from factory.eval.models.spec import EvalSettings
from factory.eval.policies.registry import PolicyNote
from schemas.base import Model, Sha256
from schemas.encoding.container import ContainerLimits, ContainerReader, ContainerWriter
from schemas.errors import InvalidBundle
from schemas.job import Job
from schemas.measure import Goal
from schemas.plan import canonical_json
from schemas.scene import Target
from schemas.support.geometry import footprint_distances
from schemas.terms import Split

_MEMBER = "driven.json"
_LIMITS = ContainerLimits(members=1, member_bytes=4 << 20)


class ResultBundle(Model):
    """Result of one episode with the metadata of its policy."""

    result: EpisodeResult
    note: PolicyNote


def write_result_bundle(driven: ResultBundle, file: BinaryIO) -> None:
    with ContainerWriter(file) as container:
        container.add(_MEMBER, driven.model_dump_json().encode())


def read_result_bundle(file: BinaryIO) -> ResultBundle:
    """Reads a bundle.

    Raises:
        InvalidBundle: The file is not a valid bundle.
    """
    text = ContainerReader(file, _LIMITS).read(_MEMBER)
    try:
        return ResultBundle.model_validate_json(text)
    except ValidationError as error:
        places = [f"{'.'.join(map(str, item['loc']))}: {item['msg']}" for item in error.errors()[:20]]
        raise InvalidBundle(f"{_MEMBER} is not valid", places) from error


_CLOCKS = {"act_ms", "seconds"}
"""Fields that are not reproducible."""
_TRACK_SLACK_M = 0.003
"""Tolerance of positions in a track, metres; they are rounded to 1 mm."""
_SPAWN_SLACK_M, _SPAWN_SLACK_RAD = 0.1, 0.2
"""Maximum displacement (metres) and rotation (radians) during the warm-up steps, in which the robot settles."""
_SPEED_SLACK, _PUSH_M = 1.5, 0.05
"""`_SPEED_SLACK`: factor by which a sliding robot can exceed the maximum speed. `_PUSH_M`: distance that contacts can
move the robot between two poses of the track, metres."""


class EvalReceipt(Model):
    """Receipt of a result for the ledger."""

    index: Annotated[int, Field(ge=1)]
    num_steps: Annotated[int, Field(ge=0)]
    content_digest: str
    """Digest of the reproducible fields; equal results have equal digests."""
    file_sha256: Sha256
    file_bytes: Annotated[int, Field(ge=1)]


def result_digest(result: EpisodeResult) -> str:
    """Returns the digest of the reproducible fields of a result, 32 hexadecimal digits."""
    return hashlib.sha256(canonical_json(result, exclude=_CLOCKS).encode()).hexdigest()[:32]


class ResultValidator:
    """Validator of evaluation results.

    Args:
        tasks: all tasks of the campaign, by job index.
    """

    def __init__(self, tasks: Mapping[int, EvalTask]) -> None:
        self._tasks = tasks

    def check(
        self,
        path: Path,
        job: Job,
        candidates: tuple[Target, ...] = (),
        scope: Scope = Scope.ALL,  # noqa: ARG002
    ) -> EvalReceipt:
        """Validates a bundle and returns its receipt for the ledger.

        Raises:
            InvalidBundle: The file is not a valid bundle, or not a result of the request; lists all reasons.
        """
        with path.open("rb") as file:
            sha256 = hashlib.file_digest(file, "sha256").hexdigest()
            size = file.tell()
            driven = read_result_bundle(file)
        task = self._tasks[job.index]
        findings = result_findings(driven.result, task, candidates[0]) if candidates else []
        if driven.note.policy != task.policy:
            findings.append(f"note of policy {driven.note.policy!r}, expected {task.policy!r}")
        if findings:
            raise InvalidBundle("the result is not valid", findings)
        return EvalReceipt(
            index=job.index,
            num_steps=driven.result.num_steps,
            content_digest=result_digest(driven.result),
            file_sha256=sha256,
            file_bytes=size,
        )

    def check_all(self, bundles: Sequence[tuple[Path, ValidationTask]]) -> list[EvalReceipt | InvalidBundle]:
        """Validates several bundles; returns the receipt or the violations of each."""
        return check_each(self.check, bundles)

    def close(self) -> None:
        """Does nothing."""


def result_findings(result: EpisodeResult, task: EvalTask, target: Target) -> list[str]:
    """Returns all contradictions between a result and its task; empty if the result is plausible.

    Args:
        result: result of a worker.
        task: task with its request and policy.
        target: target of the spec in the compiled scene.
    """
    request, settings = request_fields(task), task.setup.settings
    findings = [
        f"{name} is {getattr(result, name)!r}, expected {wanted!r}"
        for name, wanted in request.items()
        if getattr(result, name) != wanted
    ]
    return [
        *findings,
        *_of_the_end(result, settings),
        *_of_the_measures(result, settings),
        *_of_the_track(result, task, target),
    ]


def _of_the_end(result: EpisodeResult, settings: EvalSettings) -> Iterator[str]:
    task = settings.task
    if result.success != (result.end == "success"):
        yield f"success is {result.success}, but the end is {result.end}"
    if result.success and not result.any_instance:
        yield "success is true, but any_instance is false"
    if result.num_steps > task.max_steps:
        yield f"{result.num_steps} steps, more than the {task.max_steps} of the task"
    if result.end == "timeout" and result.num_steps < task.max_steps:
        yield f"timeout after {result.num_steps} of {task.max_steps} steps"
    has_goal = result.split is not Split.TEST_FALSE_PREMISE
    if result.success and has_goal and result.final_ne_m > task.success_radius_m:
        yield f"success {result.final_ne_m:.3f} m from the target, but the radius is {task.success_radius_m:g} m"
    if result.contact_steps > result.num_steps:
        yield f"{result.contact_steps} steps with contact, but only {result.num_steps} steps"


def _of_the_measures(result: EpisodeResult, settings: EvalSettings) -> Iterator[str]:
    """Checks derived fields for exact equality, because the same software computed them."""
    wanted = progresses(result.spawn_dist_m, result.final_ne_m, result.min_ne_m, settings.task)
    way = result.geodesic_m
    if not result.end.is_of_the_policy:
        wanted["spl"] = None if way is None else measure.spl(result.success, way, result.trajectory_length_m)
    for name, value in wanted.items():
        if getattr(result, name) != value:
            yield f"{name} is {getattr(result, name)}, but the other measures give {value}"
    if not result.min_ne_m <= min(result.spawn_dist_m, result.final_ne_m):
        yield f"closest point {result.min_ne_m:.3f} m away, farther than start or end"


def _of_the_track(result: EpisodeResult, task: EvalTask, target: Target) -> Iterator[str]:
    track, spec, settings = result.track, task.request.spec, task.setup.settings
    hz = settings.task.control_hz
    every = max(1, round(hz / TRACK_HZ))
    x, y, yaw = spec.spawn_pose
    if not track:
        yield "no track"
        return
    if math.dist(track[0][:2], (x, y)) > _SPAWN_SLACK_M or (
        abs(math.remainder(track[0][2] - yaw, 2 * math.pi)) > _SPAWN_SLACK_RAD
    ):
        yield f"the track starts at {track[0]}, but the episode at ({x:.3f}, {y:.3f}, {yaw:.3f})"
    if len(track) == 1 and result.end.is_of_the_policy:
        return  # the driver process was killed, so its poses are not available
    frames = {result.num_steps, result.num_steps + 1}
    if len(track) not in {math.ceil((count - 1) / every) + 1 for count in frames}:
        yield f"the track has {len(track)} poses for {result.num_steps} steps; it must have one every {every} steps"
        return
    gaps = [math.dist(a[:2], b[:2]) for a, b in itertools.pairwise(track)]
    most_m = _SPEED_SLACK * settings.robot.max_speed_mps * every / hz + _PUSH_M
    if max(gaps, default=0.0) > most_m:
        yield f"{max(gaps):.3f} m between two poses of the track, but at most {most_m:.3f} m is possible"
    if sum(gaps) > result.trajectory_length_m + len(track) * _TRACK_SLACK_M:
        yield f"the trajectory length is {result.trajectory_length_m:.3f} m, but the track is {sum(gaps):.3f} m long"
    first, last = track[0][:2], track[-1][:2]
    goal = Goal.of(target, settings.task)
    distances: dict[str, float | None] = {
        "spawn_dist_m": goal.distance(*first),
        "final_ne_m": goal.distance(*last),
        "final_centroid_m": math.dist(last, target.centroid_m[:2]),
        "final_surface_m": float(footprint_distances(last, target.footprint_m)) if target.footprint_m else None,
    }
    for name, seen in distances.items():
        reported = getattr(result, name)
        if reported is not None and seen is None:
            yield f"{name} is {reported:.3f} m, but the scene records no footprint"
        elif reported is not None and seen is not None and abs(reported - seen) > _TRACK_SLACK_M:
            yield f"{name} is {reported:.3f} m, but the track gives {seen:.3f} m"
