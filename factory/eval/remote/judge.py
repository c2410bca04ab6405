"""Validates evaluation results from workers before they are archived. Limits sizes; opens one file at a time."""

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
"""Fields that are not reproducible."""


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


class ResultJudge:
    """Validator of evaluation results.

    Args:
        tasks: all tasks of the campaign, by job index.
    """

    def __init__(self, tasks: Mapping[int, EvalTask]) -> None:
        self._tasks = tasks

    def check(self, path: Path, job: Job, target: Target | None = None) -> EvalReceipt:
        """Validates a bundle and returns its receipt for the ledger.

        Raises:
            InvalidBundle: The file is not a valid bundle, or not a result of the request; lists all reasons.
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
            raise InvalidBundle("the result is not valid", findings)
        return EvalReceipt(
            index=job.index,
            num_steps=driven.result.num_steps,
            content_digest=result_digest(driven.result),
            file_sha256=sha256,
            file_bytes=size,
        )

    def close(self) -> None:
        """Does nothing."""
