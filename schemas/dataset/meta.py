"""Model and reader of `dataset_meta.json`, which describes a dataset and the software that made it.

Also collects the versions of the installed software. Does not read episodes.
"""

from __future__ import annotations

import functools
import json
from collections.abc import Sequence
from datetime import datetime
from importlib import metadata
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, ValidationError

from schemas.base import Fraction, Line, Model, Ordinal, Sha256
from schemas.errors import ArchiveCorrupt, WorldError
from schemas.plan import Plan
from schemas.storage.dataset_files import META_FILE, is_submitted_run
from schemas.storage.place import Place
from schemas.support.shell import quoted
from schemas.terms import Recording
from schemas.view import ViewSettings

_FORMAT_WITHOUT_RIG, FORMAT_WITH_RIG, FORMAT_WITH_SOURCES, _FORMAT_WITH_CORRECTIONS = 1, 2, 3, 4
DATASET_FORMAT = _FORMAT_WITH_CORRECTIONS
"""Newest version of the dataset directory: in version 4, the plan has corrections; in version 3, the dataset has
sources; in version 2, the plan has a rig or an appearance; in version 1, none of these. A reader opens its own version
and older ones, and rejects newer ones."""
_MAX_SOURCES = 1000
_COMPATIBILITY = "Readers open this format version and older ones; a newer one they refuse by its number."
_PACKAGES = ("minivla-factory", "numpy", "pyarrow", "pydantic", "pybullet", "moderngl", "isal", "xxhash", "zstandard")


class GateOutcome(Model):
    """Result of the gate in one scene, measured before the run."""

    scene: str
    """Name of the scene."""
    expert: str
    """Controller that drove."""
    attempts: Annotated[int, Field(ge=1)]
    """Number of first attempts."""
    succeeded: Annotated[int, Field(ge=0)]
    """Number of first attempts that succeeded."""
    min_success: Fraction
    """Required fraction of successful attempts."""
    passed: bool
    """Whether the fraction was reached."""
    reasons: dict[str, int]
    """Number of attempts by fail reason."""


class Relabelling(Model):
    """Source of the new instructions of a relabelled dataset (docs/language.md)."""

    spec: str
    """Language file, as JSON with all defaults."""
    languages: tuple[str, ...]
    """Codes of the languages."""
    instructions: Annotated[int, Field(ge=0)]
    """Number of rows of `instructions.parquet`."""
    recorded: Annotated[int, Field(ge=0)]
    """Number of episodes that keep their recorded instruction, because no new one fits their target."""


class DatasetSource(Model):
    """Run whose episodes are part of a merged or extended dataset; they have consecutive numbers there."""

    name: Line
    """Name of the folder that the dataset of the run had."""
    run: Line
    """Name of the run."""
    plan_digest: Sha256
    """Digest of the plan, which the episodes record."""
    plan: Plan
    """Plan of the run."""
    first: Ordinal
    """Number of the episode that was the first one of the run."""
    episodes: Annotated[int, Field(ge=0)]
    """Number of archived episodes."""
    dataset_digest: Sha256 | None = None
    """Digest of the dataset of the run; null if it was incomplete, or was itself part of a merged dataset."""
    extends: bool = Field(default=False, exclude_if=lambda it: not it)
    """Whether `factory run --extend` has added the run; omitted if not."""

    @property
    def numbers(self) -> range:
        """Numbers of the planned episodes in the dataset."""
        return range(self.first, self.first + self.plan.episodes)

    def own_index(self, index: int) -> int:
        """Returns the number that an episode has in its run and in its file."""
        return index - self.first + 1


class DatasetMeta(Model):
    """Content of `dataset_meta.json`."""

    format: int = _FORMAT_WITHOUT_RIG
    """Version of the dataset directory."""
    compatibility: str = _COMPATIBILITY
    """Compatibility of the format version, as a sentence."""
    run: str
    """Name of the run: the plan's name and the first digits of its digest."""
    plan_digest: Sha256
    """Digest of the plan."""
    seed: int
    """Root seed of the run."""
    plan: Plan
    """The plan itself."""
    rig_digest: Sha256 | None = Field(default=None, exclude_if=lambda it: it is None)
    """Digest of the plan's rig; null and omitted if the plan has none."""
    scenes: dict[str, Sha256]
    """Digest of the compiled package in `scenes/` by scene name."""
    episodes: Annotated[int, Field(ge=0)]
    """Number of archived episodes."""
    planned: Annotated[int, Field(ge=1)]
    """Number of planned episodes."""
    failed_attempts: Annotated[int, Field(ge=0)]
    """Number of rows of `attempts.parquet`."""
    complete: bool
    """Whether every planned episode is archived."""
    dataset_digest: Sha256 | None = None
    """SHA-256 over the content digests of all episodes; null until the dataset is complete."""
    renderers: tuple[str, ...] = ()
    """Descriptions of all renderers that rendered an episode."""
    software: dict[str, str]
    """Package versions of the coordinator; each episode records those of its worker."""
    git_commit: str | None = None
    """Commit of the coordinator's checkout; null if it did not run from a checkout."""
    created_at: datetime
    """Time at which the dataset was created, UTC."""
    updated_at: datetime
    """Time of the last change, UTC."""
    shared_instances: dict[str, tuple[str, ...]] | None = None
    """Seen categories, by scene, that have too few instances to separate training from evaluation; the instances of
    every other category occur either in training or in evaluation. Null if the plan does not separate instances."""
    gate: tuple[GateOutcome, ...] = ()
    """Results of the gate before the run; empty if the gate was skipped."""
    refused_seeds: dict[str, tuple[str, ...]] = Field(default={}, exclude_if=lambda seeds: not seeds)
    """Reasons why earlier seeds of a layout were not used, by layout; omitted if there are none."""
    relabelling: Relabelling | None = Field(default=None, exclude_if=lambda it: it is None)
    """Source of the new instructions; omitted for a dataset with its recorded instructions."""
    sources: Annotated[tuple[DatasetSource, ...], Field(max_length=_MAX_SOURCES)] = Field(
        default=(), exclude_if=lambda it: not it
    )
    """Runs that `factory merge` or `factory run --extend` joined, in the order of their episodes; `plan` describes the
    whole dataset. Omitted for the dataset of one run."""

    @property
    def plans(self) -> tuple[Plan, ...]:
        """Plans of the episodes: that of each source, or that of the only run."""
        return tuple(source.plan for source in self.sources) or (self.plan,)

    def source_of(self, index: int) -> DatasetSource | None:
        """Returns the source of an episode; `None` for the dataset of one run."""
        return next((source for source in self.sources if index in source.numbers), None)

    def own_index(self, index: int) -> int:
        """Returns the number that an episode has in its run and in its file; `index`, if the dataset is of one run."""
        source = self.source_of(index)
        return index if source is None else source.own_index(index)


def described_as_frames(meta: DatasetMeta) -> DatasetMeta:
    """Returns the description with the plan changed to record frames; unchanged if the dataset stores frames."""
    if meta.plan.record is Recording.FRAMES:
        return meta
    return described_by(meta, meta.plan.model_copy(update={"record": Recording.FRAMES}))


def described_by(meta: DatasetMeta, plan: Plan) -> DatasetMeta:
    """Returns the description with its plan replaced by another plan of the same episodes."""
    fields = fields_of_plan(plan)
    return meta.model_copy(update=fields | ({"format": max(meta.format, fields["format"])} if meta.sources else {}))


def fields_of_plan(plan: Plan) -> dict[str, Any]:
    """Returns the fields of a description that depend on the plan only."""
    return {
        "format": _format_of(plan),
        "run": plan.run,
        "plan_digest": plan.digest,
        "seed": plan.seed,
        "plan": plan,
        "rig_digest": None if plan.rig is None else plan.rig.digest,
    }


def _format_of(plan: Plan) -> int:
    if plan.correction is not None:
        return _FORMAT_WITH_CORRECTIONS
    return _FORMAT_WITHOUT_RIG if plan.view == ViewSettings() else FORMAT_WITH_RIG


def read_dataset_meta(root: Place) -> DatasetMeta:
    """Reads the description of a dataset.

    Raises:
        WorldError: the directory contains no dataset, or the dataset has a newer format.
        ArchiveCorrupt: the description cannot be parsed.
    """
    path = root / META_FILE
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError as error:
        raise WorldError(f"{root} is not a dataset: {META_FILE} is missing; {_remedy(root)}") from error
    except (OSError, ValueError) as error:
        raise ArchiveCorrupt(f"{path} cannot be read: {error}") from error
    _refuse_newer(path, text)
    try:
        return DatasetMeta.model_validate_json(text)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"]))
        raise ArchiveCorrupt(f"{path} is damaged at {where!r}: {first['msg']}; resume the run to rewrite it") from error


def _remedy(root: Place) -> str:
    if isinstance(root, Path) and is_submitted_run(root):
        return f"it is the folder of a submitted run: give {root / 'dataset'}"
    if isinstance(root, Path) and is_submitted_run(root.parent):
        return (
            f"the last job of the submitted run writes it; see its progress with `factory status {quoted(root.parent)}`"
        )
    return "give the --out of `factory run`"


def _refuse_newer(path: Place, text: str) -> None:
    try:
        content = json.loads(text)
    except (ValueError, RecursionError):
        return
    version = content.get("format") if isinstance(content, dict) else None
    if isinstance(version, int) and version > DATASET_FORMAT:
        message = f"{path} has dataset format {version}, this software reads up to {DATASET_FORMAT}"
        raise WorldError(f"{message}: upgrade minivla-factory")


def software_versions(packages: Sequence[str] = _PACKAGES) -> dict[str, str]:
    """Returns the version of each given package that is installed."""
    versions = ((name, _version(name)) for name in packages)
    return {name: version for name, version in versions if version is not None}


@functools.cache
def _version(package: str) -> str | None:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None


def git_commit(checkout: Path) -> str | None:
    """Returns the current commit of a Git checkout, or `None` if the directory is not a checkout."""
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
        commit, _, packed = line.partition(" ")
        if packed == name:
            return commit
    return None
