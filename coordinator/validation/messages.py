"""Messages between the validator and its child processes: orders, verdicts, limits."""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from enum import StrEnum
from pathlib import Path
from typing import Annotated, TypeVar

from pydantic import Field

from schemas.base import Line, Model, Sha256
from schemas.dataset.rows import EpisodeSummary
from schemas.errors import InvalidBundle
from schemas.job import Job
from schemas.language.instruction import Instruction
from schemas.scene import Target

R = TypeVar("R")

MAX_FINDINGS, MAX_FINDING_CHARS = 100, 500
"""Maximum number and length of the findings of a verdict; the output of a child with a hostile bundle is untrusted."""
HEADER = struct.Struct("!I")
"""Header of an order: its length, bytes. The descriptors of the open bundles are sent with the header."""
MAX_TASKS = 64
"""Largest number of bundles in an order; the kernel sends at most 253 descriptors together."""


class Scope(StrEnum):
    """Part of a bundle that is validated."""

    ALL = "all"  # every frame and measurement
    SAMPLE = "sample"  # one frame and measurement in eight; all arrays
    CLAIM = "claim"  # container, arrays, job, target and content digest; for bundles that the worker has validated


class ValidatorLimits(Model):
    """Resource limits of a child."""

    memory_bytes: Annotated[int, Field(ge=256 << 20)] = 1536 << 20
    """Limit of the address space (RLIMIT_AS), bytes."""
    cpu_s: Annotated[int, Field(ge=1)] = 120
    """CPU time per order, seconds; 1000 frames take 4 to 7 s, and a recording of states 2 ms."""
    wall_s: Annotated[float, Field(gt=0)] = 300.0
    """Wall time per order, seconds."""


class ValidationTask(Model):
    """Task of a child for one bundle, whose descriptor is sent with the order."""

    job: Job | None = None
    """Leased job; `None` if the bundle is the package of a scene."""
    candidates: tuple[Target, ...] = ()
    """Targets of the compiled scene that the episode may have; if empty, they are not compared."""
    scope: Scope = Scope.ALL
    """Part of the bundle that is read."""
    sha256: Sha256 | None = None
    """SHA-256 of the bundle, if it is known; otherwise the child computes it."""


class ValidationOrder(Model):
    """Tasks that a child executes one after another, in the order of the descriptors."""

    tasks: Annotated[tuple[ValidationTask, ...], Field(min_length=1, max_length=MAX_TASKS)]
    """Tasks."""


class Verdict(Model):
    """Result of a task: either a summary or findings."""

    summary: EpisodeSummary | None = None
    """Row of the episode; `None` if the bundle is invalid."""
    language: Instruction | None = None
    """Verified instruction of the episode, which is then compared with the scene; `None` for a template."""
    findings: Annotated[tuple[Line, ...], Field(max_length=MAX_FINDINGS)] = ()
    """Violations."""


class Verdicts(Model):
    """Reply of a child to an order: one line of JSON."""

    verdicts: Annotated[tuple[Verdict, ...], Field(max_length=MAX_TASKS)]
    """Results of the tasks, in their order."""


def check_each(
    check: Callable[[Path, Job, tuple[Target, ...], Scope], R], bundles: Sequence[tuple[Path, ValidationTask]]
) -> list[R | InvalidBundle]:
    """Validates bundles one after another; returns the result or the violations of each."""
    results: list[R | InvalidBundle] = []
    for path, task in bundles:
        assert task.job is not None
        try:
            results.append(check(path, task.job, task.candidates, task.scope))
        except InvalidBundle as error:
            results.append(error)
    return results
