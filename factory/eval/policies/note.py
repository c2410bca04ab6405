"""What is known of a policy beside its results: how it was made, with what, and what it goes by."""

from __future__ import annotations

from factory.eval.policies import find_policy
from schemas.base import Model
from schemas.dataset_meta import software_versions

__all__ = ["PolicyNote", "note_of"]


class PolicyNote(Model):
    """Stands beside the results of a policy."""

    policy: str
    knows: str
    reads_instruction: bool
    renderer: str
    software: dict[str, str]


def note_of(policy: str, knows: str, renderer: str) -> PolicyNote:
    """Returns the note of a policy that was made on this machine."""
    return PolicyNote(
        policy=policy,
        knows=knows,
        reads_instruction=find_policy(policy).reads_instruction,
        renderer=renderer,
        software=software_versions(),
    )
