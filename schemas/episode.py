"""Models of an episode's metadata (`meta.json`): the paper's sidecar fields, provenance, software and machine.

Reads no file. The software and the machine are recorded outside of the content digest.
"""

from __future__ import annotations

from datetime import datetime
from typing import Annotated

from pydantic import Field, StringConstraints, ValidationError
from pydantic_core import from_json

from schemas.appearance import DrawnAppearance
from schemas.base import Count, Finite, Line, Model, Name, NonNegative, Ordinal, PrimPath
from schemas.errors import InvalidBundle
from schemas.instruction.start_view import InstanceIds
from schemas.job import Job
from schemas.language.instruction import Instruction
from schemas.language.question.meaning import Question
from schemas.plan import canonical_json
from schemas.scene import MAX_INSTANCES, Footprint, Instance
from schemas.terms import EndReason
from schemas.view import ViewSettings

BUNDLE_FORMAT = 4
"""Newest version of the bundle format. Bundles of version 4 have corrections (`schemas.encoding.arrays`), those of
version 3 have the measurements of a rig, those of version 2 have neither, and those of version 1 have float32 poses and
frames only. A reader opens its own version and older ones, and rejects newer ones."""
FORMAT_WITHOUT_RIG, BUNDLE_WITH_RIG = 2, 3
"""Versions of the bundles of demonstrations."""
MAX_FRAMES = 1000
"""Largest number of steps of an episode."""
_MAX_PATH_POSES = 100_000

_OUTSIDE_DIGEST = {"provenance", "content_digest", "frame_digests"}
_OF_RECORDING = {
    "instances": True,
    "job": {"record": True, "run": True, "plan_digest": True, "view": True},
    "rollout": {"steps_visible": True},
    "sensor_digests": True,
    "appearance": True,
}
"""Fields that differ between the recordings of an episode, in addition to its digests."""

Digest = Annotated[str, Field(pattern=r"^[0-9a-f]{32}$")]


class Rollout(Model):
    """Measurements of a rollout in the world frame; each number can be computed from the arrays."""

    end_reason: EndReason
    """Reason for the end of the rollout."""
    num_steps: Annotated[int, Field(ge=1, le=MAX_FRAMES)]
    """Number of frames and of actions, T."""
    spawn_pose: tuple[Finite, Finite, Finite]
    """x, y in metres and yaw in radians of base_link at frame 0."""
    spawn_dist_m: NonNegative
    """Planar distance from the spawn to the target's centroid, metres."""
    spawn_draws: Ordinal
    """Number of start poses tested in physics, the accepted one included."""
    trajectory_length_m: NonNegative
    """Trajectory length (TL): sum of planar distances between consecutive poses, metres."""
    final_ne_m: NonNegative
    """Navigation error (NE): planar distance from the last pose to the target's centroid, metres."""
    final_ne_3d_m: NonNegative
    """Navigation error in 3D: distance to the target's centroid, metres (docs/design/task.md#distances)."""
    min_ne_m: NonNegative
    """Smallest planar distance to the target's centroid over the episode, metres; oracle metrics use it."""
    collision_count: Count
    """Number of steps in which the robot touches anything but the floor."""
    steps_visible: Count | None
    """Number of steps in which the target was visible to the expert; null in a states recording of an expert that uses
    no images."""
    spawn_surface_m: NonNegative | None = Field(default=None, exclude_if=lambda it: it is None)
    """Planar distance from the spawn to the target's footprint, metres; null if the scene records no footprint."""
    final_surface_m: NonNegative | None = Field(default=None, exclude_if=lambda it: it is None)
    """Planar distance from the last pose to the target's footprint, metres; null if the scene records no footprint."""
    target_in_view: bool | None = Field(default=None, exclude_if=lambda it: it is None)
    """Whether the last frame shows the target; null in episodes of older versions."""


class Route(Model):
    """Shortest and planned paths to the target, independent of the driven trajectory."""

    geodesic_m: NonNegative | None = None
    """Length of the shortest path along the floor from the spawn to the success region, metres; `None` if the floor
    does not connect them. It is l in the formula of SPL."""
    planned: Annotated[tuple[tuple[Finite, Finite, Finite], ...], Field(max_length=_MAX_PATH_POSES)] = ()
    """Poses of the planner's path: x, y in metres and yaw in radians of base_link; empty for other experts."""


class Provenance(Model):
    """Time, worker and software of an episode; not part of the content digest."""

    created_at: datetime
    """Time at which the episode was simulated, ISO 8601, UTC."""
    worker: Line
    """Session id of the worker."""
    fingerprint: Fingerprint
    """Software and machine of the worker."""


class EpisodeMeta(Model):
    """Content of `meta.json`."""

    format: Count = FORMAT_WITHOUT_RIG
    """Version of the bundle format."""
    episode_id: Name
    """Name of the episode, e.g. `ep_000001`."""
    job: Job
    """Job that the episode was made from."""
    target_prim_path: PrimPath
    """Path of the target's USD prim."""
    target_instance_id: Annotated[int, Field(ge=0, le=MAX_INSTANCES)]
    """Id of the target in `seg_front`."""
    target_centroid_m: tuple[Finite, Finite, Finite]
    """Centre of the target's bounding box in the world frame, metres."""
    target_footprint_m: Footprint = Field(default=(), exclude_if=lambda it: not it)
    """Convex hull of the target's projection to the floor, x, y in the world frame, metres; empty if the scene records
    none."""
    phrase_is_unique: bool
    """Whether the instruction fits exactly one object of the scene. A template is compared by category and colour
    only."""
    rollout: Rollout
    """Measurements of the rollout."""
    route: Route = Route()
    """Shortest and planned paths."""
    instances: Annotated[tuple[Instance, ...], Field(max_length=MAX_INSTANCES)]
    """Instances that the ids in `seg_front` refer to; empty in a states recording, because the scene lists them."""
    frame_digests: Annotated[tuple[Digest, ...], Field(max_length=MAX_FRAMES)]
    """XXH3-128 of (rgb, depth, ids) of every frame; in a states recording, of the frames at `Job.sampled_steps`."""
    sensor_digests: Annotated[dict[Name, Digest], Field(max_length=32)] = Field(
        default_factory=dict, exclude_if=lambda it: not it
    )
    """XXH3-128 of the measurements of each sensor of the rig, by its name; empty and omitted without a rig."""
    content_digest: Digest
    """XXH3-128 over the frame digests, the arrays and the canonical metadata without `provenance`; the metadata
    contains the digests of the sensors."""
    appearance: DrawnAppearance | None = Field(default=None, exclude_if=lambda it: it is None)
    """Factors of the appearance that the frames show; null and omitted for the scene as it was compiled."""
    language: Instruction | None = Field(default=None, exclude_if=lambda it: it is None)
    """Verified instruction of a job with `language`; null and omitted for a template."""
    choices: InstanceIds = Field(default=(), exclude_if=lambda it: not it)
    """Objects that could be the target at the start, from which the target was drawn; empty and omitted if the plan
    names the target."""
    questions: Annotated[tuple[Question, ...], Field(max_length=8)] = Field(default=(), exclude_if=lambda it: not it)
    """Questions with verified answers of a job whose `language` has them; empty and omitted otherwise."""
    provenance: Provenance
    """Time, worker and software of the episode."""

    @property
    def instruction(self) -> str:
        """Instruction that the robot follows."""
        return self.job.instruction if self.language is None else self.language.text

    @property
    def template_id(self) -> str:
        """Template, or sentence pattern, of the instruction."""
        return self.job.template_id if self.language is None else self.language.template_id

    @property
    def sampled_digests(self) -> dict[int, str]:
        """Frame digests of a states recording, by step."""
        return dict(zip(self.job.sampled_steps(self.rollout.num_steps), self.frame_digests, strict=True))

    def canonical(self) -> str:
        """Returns the part of the metadata that the content digest covers, as canonical JSON."""
        return canonical_json(self, exclude=_OUTSIDE_DIGEST)

    def canonical_states(self) -> str:
        """Returns the part of the metadata that is equal in all recordings of an episode, as canonical JSON."""
        plain = self.model_copy(update={"format": min(self.format, FORMAT_WITHOUT_RIG)})
        return canonical_json(plain, exclude=dict.fromkeys(_OUTSIDE_DIGEST, True) | _OF_RECORDING)

    def with_frames(
        self, job: Job, steps_visible: int, instances: tuple[Instance, ...], appearance: DrawnAppearance | None = None
    ) -> EpisodeMeta:
        """Returns the metadata for a frames recording of this episode; the digests are those of the states recording.

        Args:
            job: job of the frames recording.
            steps_visible: number of frames in which the target is visible.
            instances: instances of the scene, and of clutter.
            appearance: factors that the frames show.
        """
        rollout = self.rollout.model_copy(update={"steps_visible": steps_visible})
        changes = {"format": format_of(job), "job": job, "rollout": rollout, "instances": instances}
        return self.model_copy(update={**changes, "appearance": appearance})


def format_of(job: Job) -> int:
    """Returns the version of the bundles of a job."""
    if job.correction is not None:
        return BUNDLE_FORMAT
    return FORMAT_WITHOUT_RIG if job.view == ViewSettings() else BUNDLE_WITH_RIG


def parse_meta(text: bytes) -> EpisodeMeta:
    """Returns the metadata of a bundle from its JSON text.

    Raises:
        InvalidBundle: the metadata is damaged or has a newer format.
    """
    try:
        return EpisodeMeta.model_validate_json(text)
    except ValidationError as error:
        newer = _newer_format(text)
        if newer is not None:
            problem = f"bundle format {newer}, this software reads up to {BUNDLE_FORMAT}: upgrade minivla-factory"
            raise InvalidBundle("bundle refused", [problem]) from error
        findings = [f"meta.json: {'.'.join(map(str, item['loc']))}: {item['msg']}" for item in error.errors()[:20]]
        raise InvalidBundle("bundle refused", findings) from error


def _newer_format(text: bytes) -> int | None:
    try:
        content = from_json(text)
    except ValueError:
        return None
    version = content.get("format") if isinstance(content, dict) else None
    return version if isinstance(version, int) and version > BUNDLE_FORMAT else None


_Word = Annotated[str, StringConstraints(max_length=200)]


class Fingerprint(Model):
    """Versions and machine properties that may affect a frame's bytes (docs/design/reproducibility.md#machines)."""

    software: Annotated[dict[_Word, _Word], Field(max_length=64)]
    """Versions, by package name, of all software that affects the recorded bytes, this product included."""
    renderer: Line
    """Description that the renderer gives of itself, e.g. the GL renderer string."""
    cpu: Line
    """CPU model name and machine type."""
