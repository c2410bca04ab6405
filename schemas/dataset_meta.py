"""`dataset_meta.json`: what a dataset is and what made it, for readers and for the next run. A model; reads one file.

Collects versions of the software at hand; never looks at episodes.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from datetime import datetime
from importlib import metadata
from pathlib import Path
from typing import Annotated

from pydantic import Field, ValidationError

from schemas.base import Fraction, Model, Sha256
from schemas.dataset_files import META_FILE
from schemas.errors import ArchiveCorrupt, WorldError
from schemas.plan import Plan
from schemas.storage.place import Place

__all__ = [
    "DATASET_FORMAT",
    "DatasetMeta",
    "GateOutcome",
    "git_commit",
    "read_dataset_meta",
    "software_versions",
]

DATASET_FORMAT = 1
"""Version of the dataset's directory. A reader opens its own version and older ones; a newer one it refuses by name."""
_COMPATIBILITY = "Readers open this format version and older ones; a newer one they refuse by its number."
_PACKAGES = ("minivla-factory", "numpy", "pyarrow", "pydantic", "pybullet", "moderngl", "isal", "xxhash", "zstandard")


class GateOutcome(Model):
    """What a pilot of first attempts found in one scene, before the run."""

    scene: str
    expert: str
    attempts: Annotated[int, Field(ge=1)]
    succeeded: Annotated[int, Field(ge=0)]
    min_success: Fraction
    """Share asked for."""
    passed: bool
    reasons: dict[str, int]
    """Fail reason -> attempts."""


class DatasetMeta(Model):
    """The whole of `dataset_meta.json`."""

    format: int = DATASET_FORMAT
    compatibility: str = _COMPATIBILITY
    run: str
    """Name of the run: the plan's name and the beginning of its digest."""
    plan_digest: Sha256
    seed: int
    """Root of every random choice."""
    plan: Plan
    scenes: dict[str, Sha256]
    """Scene name -> digest of the compiled package in `scenes/`."""
    episodes: Annotated[int, Field(ge=0)]
    """Archived so far."""
    planned: Annotated[int, Field(ge=1)]
    failed_attempts: Annotated[int, Field(ge=0)]
    """Rows of `attempts.parquet`."""
    complete: bool
    """Whether every planned episode is archived."""
    dataset_digest: Sha256 | None = None
    """SHA-256 over the content digests of all episodes, once complete."""
    renderers: tuple[str, ...] = ()
    """Every renderer that brought an episode."""
    software: dict[str, str]
    """Package versions of the coordinator; each episode has its worker's own."""
    git_commit: str | None = None
    """Of the coordinator's checkout, where it ran from one."""
    created_at: datetime
    updated_at: datetime
    shared_instances: dict[str, tuple[str, ...]] | None = None
    """Scene -> seen categories whose instances training and evaluation share, for the scene has too few of them; every
    other instance is named by one side only. Null where the plan does not keep them apart."""
    gate: tuple[GateOutcome, ...] = ()
    """Pilots that ran before the plan was handed out; none where the gate was skipped."""


def read_dataset_meta(root: Place) -> DatasetMeta:
    """Reads the description of a dataset.

    Raises:
        WorldError: there is none in that directory, or it is of a newer format.
        ArchiveCorrupt: it cannot be understood.
    """
    path = root / META_FILE
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError as error:
        raise WorldError(f"{root} is not a dataset: {META_FILE} is missing; give the --out of `factory run`") from error
    except (OSError, ValueError) as error:
        raise ArchiveCorrupt(f"{path} cannot be read: {error}") from error
    _refuse_newer(path, text)
    try:
        return DatasetMeta.model_validate_json(text)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"]))
        raise ArchiveCorrupt(f"{path} is damaged at {where!r}: {first['msg']}; resume the run to rewrite it") from error


def _refuse_newer(path: Place, text: str) -> None:
    try:
        found = json.loads(text)
    except (ValueError, RecursionError):
        return
    version = found.get("format") if isinstance(found, dict) else None
    if isinstance(version, int) and version > DATASET_FORMAT:
        message = f"{path} has dataset format {version}, this software reads up to {DATASET_FORMAT}"
        raise WorldError(f"{message}: upgrade minivla-factory")


def software_versions(packages: Sequence[str] = _PACKAGES) -> dict[str, str]:
    """Returns the versions of those packages that are installed."""
    found: dict[str, str] = {}
    for name in packages:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return found


def git_commit(checkout: Path) -> str | None:
    """Returns the commit a checkout stands at, or `None` where there is no checkout."""
    git = checkout / ".git"
    try:
        head = (git / "HEAD").read_text(encoding="ascii").strip()
        if not head.startswith("ref: "):
            return head
        name = head.removeprefix("ref: ")
        loose = git / name
        return loose.read_text(encoding="ascii").strip() if loose.is_file() else _packed(git, name)
    except (OSError, UnicodeDecodeError):
        return None


def _packed(git: Path, name: str) -> str | None:
    for line in (git / "packed-refs").read_text(encoding="ascii").splitlines():
        commit, _, found = line.partition(" ")
        if found == name:
            return commit
    return None
