"""Bundle to validate: its file, its job, and what is known about it. Reads nothing."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple, TypeVar

from coordinator.validation.scope import Scope
from schemas.errors import InvalidBundle
from schemas.job import Job
from schemas.scene import Target

R = TypeVar("R")


class BundleFile(NamedTuple):
    """Bundle to validate."""

    path: Path
    """Path of the bundle, usually a part file."""
    job: Job
    """Leased job."""
    candidates: tuple[Target, ...] = ()
    """Targets of the compiled scene that the episode may have; if empty, they are not compared."""
    scope: Scope = Scope.ALL
    """Part of the bundle that is read."""
    sha256: str | None = None
    """SHA-256 of the file, if this process has computed it; otherwise the validator does."""


def check_each(
    check: Callable[[Path, Job, tuple[Target, ...], Scope], R], files: Sequence[BundleFile]
) -> list[R | InvalidBundle]:
    """Validates bundles one after another; returns the result or the violations of each."""
    found: list[R | InvalidBundle] = []
    for file in files:
        try:
            found.append(check(file.path, file.job, file.candidates, file.scope))
        except InvalidBundle as error:
            found.append(error)
    return found
