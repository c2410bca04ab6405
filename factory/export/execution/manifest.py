"""Reads, writes and compares `export.json`: source, options and completeness of an export; models of its report.

Contains no times, so equal exports have equal bytes.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pydantic import Field, ValidationError, model_validator

from factory.export.output import WORK_FOLDER, Output
from factory.export.questions import QuestionCount
from schemas.base import Model, Sha256
from schemas.dataset.meta import DatasetMeta, software_versions
from schemas.errors import WorldError
from schemas.terms import Recording


class Skip(Model):
    """Episode that could not be exported, with the reason."""

    episode_id: str
    reason: str


class ExportReport(Model):
    """Report of an export."""

    dataset: str
    dataset_digest: str | None
    """Digest of the dataset, as `factory verify` prints it."""
    format: str
    out: str
    episodes: int
    """Number of episodes in the export."""
    frames: int
    """Number of frames in the export."""
    resumed: int
    """Number of episodes that earlier, interrupted calls exported."""
    skipped: tuple[Skip, ...]
    absent: tuple[str, ...]
    """Ids of planned episodes that the dataset does not have, because the run is unfinished or has abandoned them;
    empty if episodes were selected by id."""
    unselected: tuple[str, ...]
    """Ids that were selected by `--episode`, but are in other splits than the selected ones."""
    rig_left_out: str | None
    """Rig of the dataset's plan whose sensors the format supports, if the recorded camera is exported; else null."""
    bytes: int
    """Size of the export, bytes."""
    seconds: float
    """Wall time of this call, seconds."""
    frames_per_second: float | None
    """Frames per second of this call; null if it wrote no episode."""
    complete: bool
    """Whether the export contains all selected episodes."""
    questions: QuestionCount | None = None
    """Numbers of questions; null if the episodes have none, or if the format does not contain questions."""
    render_command: str | None = None
    """Command that stores the frames of the dataset, so that further exports do not render them again; null if this
    call has rendered no frames, or if the frames of the dataset cannot be stored."""

    @property
    def finished(self) -> bool:
        """Whether the export has ended and is usable; some episodes may have been skipped."""
        return self.complete or bool(self.skipped)


MANIFEST_FILE = "export.json"


_VERSION = 2
"""Version of the manifest format. Version 1 had the rows digest in the place of the dataset digest, and no record."""


class Source(Model):
    """Source of an export.

    `run`, `record` and `dataset_digest` identify the dataset. `frames_run`, `rows_digest` and `selection_digest` are
    equal for a frames and a states recording of the same plan; exports are equal if they, format and options are equal.
    """

    run: str
    """Name of the run, as the dataset states it."""
    record: Recording | None = None
    """Kind of recording of the dataset; null in exports of manifest version 1."""
    dataset_digest: Sha256 | None
    """Digest of the dataset, as `factory verify` prints it; null in exports of manifest version 1."""
    frames_run: str
    """Name of the run of a frames recording of the same plan."""
    rows_digest: Sha256
    """SHA-256 over the rows of all episodes of the dataset, see `factory.export.source.rows_digest`."""
    selection_digest: Sha256
    """SHA-256 over the rows of the selected episodes."""
    splits: tuple[str, ...]
    """Selected splits; empty for all."""
    episodes: int
    """Number of selected episodes."""


class ExportManifest(Model):
    """Content of `export.json`."""

    manifest: int = _VERSION
    """Version of the manifest format."""
    format: str
    format_version: int
    options: dict[str, Any]
    source: Source
    software: dict[str, str]
    """Package -> version, for the packages that wrote the files."""
    episodes: int = Field(default=0, ge=0)
    """Number of episodes in the export."""
    frames: int = Field(default=0, ge=0)
    complete: bool = False
    """Whether the export contains all selected episodes."""
    skipped: tuple[Skip, ...] = ()
    questions: QuestionCount | None = Field(default=None, exclude_if=lambda it: it is None)
    """Numbers of questions; omitted if the episodes have none, or if the format does not contain questions."""

    @model_validator(mode="before")
    @classmethod
    def _upgrade(cls, values: Any) -> Any:
        """Reads version 1, in which `dataset_digest` was the digest of the rows and `run` that of the frames plan."""
        if isinstance(values, dict) and values.get("manifest") == 1 and isinstance(values.get("source"), dict):
            source = values["source"]
            former = {"frames_run": source.get("run"), "rows_digest": source.get("dataset_digest")}
            return {**values, "source": {**source, **former, "dataset_digest": None}}
        return values


def read_manifest(root: Path) -> ExportManifest | None:
    """Returns the manifest of a directory, or `None` if it has none.

    Raises:
        WorldError: the manifest is damaged.
    """
    path = root / MANIFEST_FILE
    try:
        return ExportManifest.model_validate_json(path.read_bytes())
    except FileNotFoundError:
        return None
    except (OSError, ValidationError) as error:
        text = str(error).splitlines()[0]
        raise WorldError(f"{path} is damaged ({text}): delete {root}, or choose another --out") from error


def write_manifest(out: Output, manifest: ExportManifest) -> None:
    out.write_text(MANIFEST_FILE, manifest.model_dump_json(indent=1) + "\n")


def require_same_export(root: Path, wanted: ExportManifest) -> ExportManifest | None:
    """Checks that a directory is free for an export or contains the same export. Writes nothing.

    Returns:
        The manifest of the existing export, or `None`.

    Raises:
        WorldError: the directory contains other files, an export of another dataset, format or options, or an
            unfinished export of other software.
    """
    manifest = read_manifest(root) if root.is_dir() else None
    if manifest is None:
        if root.exists() and (not root.is_dir() or _entries(root)):
            raise WorldError(f"{root} exists and is not an export ({MANIFEST_FILE} is missing): choose another --out")
        return None
    differences = [text for text in _differences(manifest, wanted) if text]
    if differences:
        raise WorldError(
            f"{root} contains another export: {'; '.join(differences)}; delete it, or choose another --out"
        )
    return manifest


def of_software(meta: DatasetMeta, modules: tuple[str, ...]) -> dict[str, str]:
    """Returns the versions of the packages that the files of an export depend on."""
    return {"dataset_format": str(meta.format), **software_versions(("minivla-factory", "numpy", "pyarrow", *modules))}


def _entries(root: Path) -> list[str]:
    return [path.name for path in root.iterdir() if path.name != WORK_FOLDER]


def _differences(recorded: ExportManifest, wanted: ExportManifest) -> list[str]:
    one, two = recorded.source, wanted.source
    texts = [
        _differ("format", recorded.format, wanted.format),
        _differ_in_dataset(one, two),
        _differ("options", _format_pairs(recorded.options), _format_pairs(wanted.options)),
    ]
    if not any(texts):
        texts.append(_differ("episodes", _selection(one), _selection(two)))
    if not any(texts) and not recorded.complete:
        versions = (f"version {recorded.format_version}", _format_pairs(recorded.software))
        texts.append(_differ("unfinished, started with", ", ".join(versions), _versions(wanted)))
    return texts


def _versions(manifest: ExportManifest) -> str:
    return f"version {manifest.format_version}, {_format_pairs(manifest.software)}"


def _selection(source: Source) -> str:
    return f"{source.episodes} of {' '.join(source.splits) or 'all splits'} ({source.selection_digest[:12]})"


def _differ_in_dataset(one: Source, two: Source) -> str:
    if (one.frames_run, one.rows_digest) == (two.frames_run, two.rows_digest):
        return ""
    recorded, wanted = (f"{each.run} {(each.dataset_digest or each.rows_digest)[:12]}" for each in (one, two))
    return f"dataset {recorded}, requested {wanted}"


def _differ(what: str, recorded: str, wanted: str) -> str:
    return "" if recorded == wanted else f"{what} {recorded}, requested {wanted}"


def _format_pairs(values: dict[str, Any]) -> str:
    return ", ".join(f"{name}={value}" for name, value in sorted(values.items())) or "none"
