"""Model of an evaluation request: an episode with one instruction. Equal requests have equal results. Does no I/O."""

from __future__ import annotations

from factory.eval.models.result import Variant
from factory.eval.models.spec import EvalSpec
from schemas.base import Model, Name, Sha256

__all__ = ["Actions", "EvalRequest", "Key"]

Actions = tuple[tuple[float, float], ...]
"""Actions (v, w) in m/s and rad/s, one pair per step."""
Key = tuple[str, Variant, str]
"""Spec id, variant and instruction, which identify an episode among the results of a policy."""


class EvalRequest(Model):
    """Episode and instruction for a policy."""

    spec: EvalSpec
    spec_digest: Sha256
    instruction: str
    variant: Variant = Variant.ORIGINAL
    recorded: Name | None = None
    """Archived episode whose actions `replay` or `playback` executes."""
    with_pose: bool = False

    @property
    def key(self) -> Key:
        """Key of its result."""
        return self.spec.spec_id, self.variant, self.instruction
