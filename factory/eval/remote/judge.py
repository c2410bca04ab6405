"""Judges what workers bring of an evaluation, before it is archived. Reads bounded JSON; opens one file at a time."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

from pydantic import Field

from factory.eval.models.messages import EvalTask
from factory.eval.models.result import EpisodeResult
from factory.eval.remote.check_result import result_findings
from factory.eval.remote.driven import read_driven
from schemas.base import Model, Sha256
from schemas.errors import InvalidBundle
from schemas.job import Job
from schemas.plan import canonical_json
from schemas.scene import Target

__all__ = ["EvalReceipt", "ResultJudge", "result_digest"]

_CLOCKS = {"act_ms", "seconds"}
"""What does not repeat."""


class EvalReceipt(Model):
    """What the ledger keeps of a result."""

    index: Annotated[int, Field(ge=1)]
    num_steps: Annotated[int, Field(ge=0)]
    content_digest: str
    """Over the numbers that repeat; equal results have equal digests."""
    file_sha256: Sha256
    file_bytes: Annotated[int, Field(ge=1)]


def result_digest(result: EpisodeResult) -> str:
    """Returns 32 hexadecimal digits over all that repeats of a result."""
    return hashlib.sha256(canonical_json(result, exclude=_CLOCKS).encode()).hexdigest()[:32]


class ResultJudge:
    """Holds what was asked.

    Args:
        tasks: job index -> task.
    """

    def __init__(self, tasks: Mapping[int, EvalTask]) -> None:
        self._tasks = tasks

    def check(self, path: Path, job: Job, target: Target | None = None) -> EvalReceipt:
        """Returns what the ledger keeps of a bundle.

        Raises:
            InvalidBundle: it is none, or no answer to the question; with every reason.
        """
        with path.open("rb") as file:
            sha256 = hashlib.file_digest(file, "sha256").hexdigest()
            size = file.tell()
            driven = read_driven(file)
        task = self._tasks[job.index]
        findings = [] if target is None else result_findings(driven.result, task, target)
        if driven.note.policy != task.policy:
            findings.append(f"note of policy {driven.note.policy!r}, asked {task.policy!r}")
        if findings:
            raise InvalidBundle("result refused", findings)
        return EvalReceipt(
            index=job.index,
            num_steps=driven.result.num_steps,
            content_digest=result_digest(driven.result),
            file_sha256=sha256,
            file_bytes=size,
        )

    def close(self) -> None:
        """Has nothing to end."""
