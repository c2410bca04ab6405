"""Metadata of an evaluated policy: the information it uses, the renderer and the software versions. Runs no policy."""

from __future__ import annotations

from factory.eval.policies import find_policy
from schemas.base import Model
from schemas.dataset.meta import software_versions


class PolicyNote(Model):
    """Metadata stored next to the results of a policy."""

    policy: str
    knows: str
    reads_instruction: bool
    renderer: str
    software: dict[str, str]


def note_of(policy: str, knows: str, renderer: str) -> PolicyNote:
    """Returns the metadata of a policy that was created on this machine."""
    return PolicyNote(
        policy=policy,
        knows=knows,
        reads_instruction=find_policy(policy).reads_instruction,
        renderer=renderer,
        software=software_versions(),
    )
