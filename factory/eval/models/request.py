"""What is asked of a policy: an episode under one instruction. A model; the same question has the same answer."""

from __future__ import annotations

from factory.eval.models.result import Variant
from factory.eval.models.spec import EvalSpec
from schemas.base import Model, Name, Sha256

__all__ = ["Actions", "EvalRequest", "Key"]

Actions = tuple[tuple[float, float], ...]
"""(v, w) in m/s and rad/s, one pair a step."""
Key = tuple[str, Variant, str]
"""Spec id, variant and words: what a finished episode is known by among those of one policy."""


class EvalRequest(Model):
    """An episode, and what the policy is told of it."""

    spec: EvalSpec
    spec_digest: Sha256
    instruction: str
    variant: Variant = Variant.ORIGINAL
    recorded: Name | None = None
    """The archived episode that `replay` or `playback` carries out."""
    with_pose: bool = False

    @property
    def key(self) -> Key:
        """By which its answer is found again."""
        return self.spec.spec_id, self.variant, self.instruction
