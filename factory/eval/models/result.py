"""What came of one evaluation episode: one row of the results. A model; computes nothing."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated

from pydantic import Field

from schemas.base import Fraction, Model, Name, NonNegative, Sha256
from schemas.terms import Split, Tier

__all__ = ["RESULTS_FORMAT", "EpisodeResult", "EvalEnd", "Variant"]

RESULTS_FORMAT = 1
"""Version of the results. A reader opens its own version and older ones; a newer one it refuses by name."""


class Variant(StrEnum):
    """Which instruction the policy was given."""

    ORIGINAL = "original"  # the spec's own
    SHUFFLED = "shuffled"  # that of another episode of the set
    WRONG = "wrong"  # the same template, naming another category of the scene
    EMPTY = "empty"  # none


class EvalEnd(StrEnum):
    """Why an episode ended; all but the first are failures."""

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
        """Whether the policy failed as a program."""
        return self.value.startswith("policy_")


class EpisodeResult(Model):
    """One episode under one policy and one instruction; distances planar, metres."""

    spec_id: Name
    spec_digest: Sha256
    """Results with equal digests answer the same question."""
    policy: str
    variant: Variant
    instruction: str
    """As given to the policy."""
    split: Split
    scene: Name
    tier: Tier
    category: Name
    target_id: Name
    template_id: Name
    categories_in_view: Annotated[int, Field(ge=0)]
    """Categories in view at the start."""
    end: EvalEnd
    detail: str
    """The end in words."""
    success: bool
    any_instance: bool
    """Whether the success rule was met at the target or at another object of its category."""
    num_steps: Annotated[int, Field(ge=0)]
    spawn_dist_m: NonNegative
    trajectory_length_m: NonNegative
    """TL."""
    final_ne_m: NonNegative
    """NE: distance to the target's centroid at the end."""
    min_ne_m: NonNegative
    geodesic_m: NonNegative | None
    """l: the way along the floor at the start."""
    spl: Fraction | None
    """`None` where there is no way along the floor."""
    soft_spl: Fraction | None
    progress_final: float
    """OP from the start to the end: negative when driven away."""
    progress_max: float
    """OP to the closest point of the drive."""
    progress_normalised: float
    """The same with the success radius taken off both ends, so that 1 is a success; at most 1."""
    contact_steps: Annotated[int, Field(ge=0)]
    """Steps with a contact other than the floor."""
    clipped_actions: Annotated[int, Field(ge=0)]
    """Actions beyond the robot's range, which were cut to it."""
    act_ms: NonNegative
    """Mean wall time of an answer of the policy, milliseconds; not part of the numbers that repeat."""
    seconds: NonNegative
    """Wall time of the episode; not part of the numbers that repeat."""
    track: tuple[tuple[float, float, float], ...]
    """x, y in metres (to 1 mm) and yaw in radians (to 1 mrad), every tenth of a second, the last frame included."""

    @property
    def key(self) -> tuple[str, Variant, str]:
        """By which it is known among the results of its policy, as its question is."""
        return self.spec_id, self.variant, self.instruction

    @property
    def is_grounded(self) -> bool:
        """Whether at least two categories were in view at the start, so that the words were needed."""
        return self.categories_in_view >= 2
