"""Model of the result of one evaluation episode, a row of the results table. Computes nothing."""

from __future__ import annotations

import math
from collections.abc import Mapping
from enum import StrEnum
from types import MappingProxyType
from typing import Annotated, Final, Literal

from pydantic import Field

from schemas.base import Fraction, Model, Name, NonNegative, Sha256
from schemas.terms import Split, Tier

RESULTS_FORMAT = 1
"""Format version of the results. Readers accept this version and older ones, and raise an error for a newer one."""


_REST_ROWS, _REST_M = 10, 0.05
"""A robot that moves less than this distance in the last rows of its track, one second, has stopped."""


class Variant(StrEnum):
    """Instruction variant."""

    ORIGINAL = "original"  # the instruction of the spec
    SHUFFLED = "shuffled"  # the instruction of another episode of the set
    WRONG = "wrong"  # the same template with another category of the scene
    EMPTY = "empty"  # an empty instruction


class EvalEnd(StrEnum):
    """End of an episode; all except `success` are failures."""

    SUCCESS = "success"
    COLLISION = "collision"
    TIMEOUT = "timeout"
    POLICY_RAISED = "policy_raised"
    POLICY_HUNG = "policy_hung"
    POLICY_INVALID = "policy_invalid"
    POLICY_DIED = "policy_died"
    POLICY_LOST = "policy_lost"

    @property
    def is_of_the_policy(self) -> bool:
        return self.value.startswith("policy_")


class FailureKind(StrEnum):
    """What went wrong in a failed episode; the values are the words of pages and tables."""

    STOPPED_EARLY = "stopped early"  # at rest outside the success region, with the target in view
    OTHER_INSTANCE = "other instance"  # met the success rule at another object of the category
    LOST_TARGET = "lost the target"  # the target was not in view at the end
    COLLISION = "collision"
    STEP_LIMIT = "step limit"  # still driving with the target in view
    TIMEOUT = "timeout"  # false premises, and results of older versions, without a record of the view
    POLICY = "policy failure"


REAL: Final = "real"
MAX_LATENCY_MS = 60_000.0
Latency = Literal["real"] | Annotated[float, Field(ge=0, le=MAX_LATENCY_MS)]
"""Time that passes in the simulation for each answer of a policy: milliseconds, or `real` for the measured time."""


Attention = tuple[Fraction, Fraction, Fraction]
"""Where a policy located an object: column and row as fractions of the image, and a confidence."""


class TrainingNote(Model):
    """What a policy states about its training."""

    digest: Sha256
    """Digest of the training episodes, as `Dataset.digest` returns it."""
    episodes: Annotated[int, Field(ge=1)]


class EpisodeResult(Model):
    """Result of one episode with one policy and one instruction; distances are planar, metres."""

    spec_id: Name
    spec_digest: Sha256
    """Digest of spec and settings; results with equal digests are comparable."""
    policy: str
    variant: Variant
    instruction: str
    """Instruction given to the policy."""
    split: Split
    scene: Name
    tier: Tier
    category: Name
    target_id: Name
    template_id: Name
    categories_in_view: Annotated[int, Field(ge=0)]
    """Number of categories in view at the start."""
    end: EvalEnd
    detail: str
    """Description of the end."""
    success: bool
    any_instance: bool
    """Whether the success rule was met at the target or at another object of its category."""
    num_steps: Annotated[int, Field(ge=0)]
    spawn_dist_m: NonNegative
    trajectory_length_m: NonNegative
    """Trajectory length (TL)."""
    final_ne_m: NonNegative
    """Navigation error (NE): distance to the target at the end. This distance, `spawn_dist_m` and `min_ne_m` use the
    success measure."""
    min_ne_m: NonNegative
    final_centroid_m: NonNegative | None = None
    """NE to the centroid; `None` in results of older versions, and if the driver process was killed or died."""
    final_surface_m: NonNegative | None = None
    """NE to the footprint; `None` if `final_centroid_m` is `None`, or if the scene records no footprint."""
    geodesic_m: NonNegative | None
    """Geodesic distance to the success region at the start, which is l in SPL; `None` without a path."""
    spl: Fraction | None
    """SPL; `None` without a path on the floor."""
    soft_spl: Fraction | None
    progress_final: float
    """OP by the success measure, from the start to the end; negative if the distance increased."""
    progress_max: float
    """OP from the start to the closest point of the track."""
    progress_normalised: float
    """`progress_max` computed from the distances minus the success radius; 1 if the track enters the radius."""
    contact_steps: Annotated[int, Field(ge=0)]
    """Number of steps with a contact other than the floor."""
    clipped_actions: Annotated[int, Field(ge=0)]
    """Number of actions that were clipped to the range of the robot."""
    act_ms: NonNegative
    """Mean wall time of a policy call, milliseconds; not reproducible."""
    seconds: NonNegative
    """Wall time of the episode, seconds; not reproducible."""
    trained_on: bool | None = Field(default=None, exclude_if=lambda it: it is None)
    """Whether the policy was trained on an episode with the same scene, target and start; `None` and omitted if the
    policy does not state its training episodes."""
    target_in_view: bool | None = Field(default=None, exclude_if=lambda it: it is None)
    """Whether the camera showed the target at the end of an episode that reached the step limit; otherwise, and in
    results of older versions, `None` and omitted."""
    track: tuple[tuple[float, float, float], ...]
    """x, y in metres (to 1 mm) and yaw in radians (to 1 mrad), at 10 Hz and at the last frame."""

    attention: tuple[Attention | None, ...] = Field(default=(), exclude_if=lambda it: not it)
    """Where the policy located the named object in its last image before each row of the track; empty and omitted for
    policies that do not say."""

    @property
    def failure(self) -> FailureKind | None:
        """Kind of the failure; `None` after a success."""
        if self.success:
            return None
        if self.end.is_of_the_policy:
            return FailureKind.POLICY
        if self.end is EvalEnd.COLLISION:
            return FailureKind.COLLISION
        if self.any_instance:
            return FailureKind.OTHER_INSTANCE
        if self.target_in_view is None:
            return FailureKind.TIMEOUT
        if not self.target_in_view:
            return FailureKind.LOST_TARGET
        last = self.track[-_REST_ROWS:]
        moved_m = max(math.dist(row[:2], last[-1][:2]) for row in last)
        return FailureKind.STOPPED_EARLY if moved_m < _REST_M else FailureKind.STEP_LIMIT

    @property
    def key(self) -> tuple[str, Variant, str]:
        """Key among the results of its policy, equal to the key of its request."""
        return self.spec_id, self.variant, self.instruction

    @property
    def oracle_success(self) -> bool:
        """Whether the robot was within the success radius at any time (oracle success of VLN-CE).

        Without a goal, which is the case for a false premise, it is the success.
        """
        return self.progress_normalised >= 1.0

    @property
    def is_grounded(self) -> bool:
        """Returns whether at least two categories were in view at the start, so the instruction was needed."""
        return self.categories_in_view >= 2


MEANS: Mapping[str, str] = MappingProxyType(
    {
        "ne_m": "final_ne_m",
        "ne_centroid_m": "final_centroid_m",
        "ne_surface_m": "final_surface_m",
        "trajectory_length_m": "trajectory_length_m",
        "spl": "spl",
        "soft_spl": "soft_spl",
        "progress_final": "progress_final",
        "progress_max": "progress_max",
        "progress_normalised": "progress_normalised",
        "num_steps": "num_steps",
    }
)
"""Measure in tables -> field of `EpisodeResult`."""
BOUNDS: Mapping[str, tuple[float, float]] = MappingProxyType(
    {
        **dict.fromkeys(("spl", "soft_spl", "progress_max", "progress_normalised"), (0.0, 1.0)),
        **dict.fromkeys(("ne_m", "ne_centroid_m", "ne_surface_m", "trajectory_length_m", "num_steps"), (0.0, math.inf)),
    }
)
"""Smallest and largest value of the measures that have bounds."""
DIFFERENCE_BOUNDS: Mapping[str, tuple[float, float]] = MappingProxyType(
    {name: (low - high, high - low) for name, (low, high) in BOUNDS.items() if math.isfinite(high)}
)
"""Smallest and largest value of paired differences of these measures."""
