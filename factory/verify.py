"""Verification of a dataset: every file against the tables, and deep: every byte against itself and the plan.

Reads only, needs no ledger, prints nothing; finds all, never stops at the first.
"""

from __future__ import annotations

import hashlib
import os
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from coordinator.archive import EPISODES, SCENES, index_of_file
from coordinator.catalog import SceneEntry, read_entry
from coordinator.dataset_card import CARD_FILE
from coordinator.dataset_meta import META_FILE, DatasetMeta
from coordinator.dataset_tables import ATTEMPTS_FILE, METADATA_FILE
from coordinator.draw import cells
from coordinator.summary import EpisodeSummary, summary_of
from coordinator.validate import validate
from factory.dataset import Dataset
from schemas.bundle import BundleReader
from schemas.errors import ArchiveCorrupt, InvalidBundle
from schemas.job import episode_id
from schemas.scene import Target

__all__ = ["Finding", "Kind", "Report", "verify"]

Progress = Callable[[int, int], None]


class Kind(StrEnum):
    """What is wrong, in one word."""

    MISSING = "missing"  # a table names it, the disk does not have it
    SURPLUS = "surplus"  # an episode file that no table names
    FOREIGN = "foreign"  # a file that is no part of a dataset
    TRUNCATED = "truncated"  # shorter or longer than recorded
    CHANGED = "changed"  # other bytes than recorded
    INVALID = "invalid"  # breaks the format, the laws of motion or its own digests
    CONTRADICTION = "contradiction"  # the tables say something else than the episode or the plan
    DAMAGED = "damaged"  # a table or scene that cannot be read


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong."""

    kind: Kind
    file: str
    """Below the dataset's directory."""
    text: str
    """What was found, with values."""


@dataclass
class Report:
    """What a verification found."""

    root: Path
    deep: bool
    episodes: int = 0
    """In the tables."""
    complete: bool = False
    """Whether the dataset says that every planned episode is there."""
    digest: str | None = None
    """Of the dataset, from its tables; `None` when they cannot be read."""
    findings: list[Finding] = field(default_factory=list)

    @property
    def ok(self) -> bool:
        """Whether nothing is wrong."""
        return not self.findings

    def add(self, kind: Kind, file: str, *texts: str) -> None:
        """Notes findings about one file."""
        self.findings += [Finding(kind, file, text) for text in texts]


def verify(root: Path, deep: bool = False, on_progress: Progress = lambda _done, _all: None) -> Report:
    """Checks a whole dataset.

    Shallow: tables readable and agreeing with each other, every file there with its size and SHA-256, none too many.
    Deep: besides, every frame decoded, digests and motion recomputed, rows compared with the episodes, scene packages
    hashed and quotas compared with the plan.

    Args:
        root: of the dataset.
        deep: whether to look into the episodes.
        on_progress: called with the number of episodes checked and their total.

    Raises:
        WorldError: there is no dataset, or it is of a newer format.
    """
    report = Report(root, deep)
    try:
        dataset = Dataset(root)
    except ArchiveCorrupt as error:
        report.add(Kind.DAMAGED, str(root), str(error))
        return report
    report.episodes, report.complete, report.digest = len(dataset), dataset.meta.complete, dataset.digest
    rows = _rows(dataset, report)
    _check_listing(root, rows, report)
    _check_tables(dataset, rows, report)
    scenes = _check_scenes(root, dataset.meta, report)
    for done, row in enumerate(rows.values(), 1):
        _check_episode(root, row, scenes, report)
        on_progress(done, len(rows))
    if deep:
        _check_quotas(dataset.meta, rows, report)
    return report


def _rows(dataset: Dataset, report: Report) -> dict[str, EpisodeSummary]:
    rows: dict[str, EpisodeSummary] = {}
    for position in range(len(dataset)):
        try:
            summary = dataset[position].summary
        except ArchiveCorrupt as error:
            report.add(Kind.DAMAGED, METADATA_FILE, f"row {position}: {error}")
            continue
        if summary.episode_id in rows:
            report.add(Kind.CONTRADICTION, METADATA_FILE, f"{summary.episode_id} stands twice")
        if summary.episode_id != episode_id(summary.index):
            report.add(Kind.CONTRADICTION, METADATA_FILE, f"{summary.episode_id} has index {summary.index}")
        rows[summary.episode_id] = summary
    return rows


def _check_listing(root: Path, rows: dict[str, EpisodeSummary], report: Report) -> None:
    for entry in _entries(root / EPISODES):
        name = f"{EPISODES}/{entry.name}"
        index = index_of_file(entry.name) if entry.is_file(follow_symlinks=False) else None
        if index is None:
            report.add(Kind.FOREIGN, name, "is no episode by its name")
        elif episode_id(index) not in rows:
            report.add(
                Kind.SURPLUS, name, f"{METADATA_FILE} does not name it (while a run is under way, it lags behind)"
            )
    known = {EPISODES, SCENES, META_FILE, METADATA_FILE, ATTEMPTS_FILE, CARD_FILE, "quarantine"}
    for entry in _entries(root):
        is_hidden = entry.name.startswith(".")
        if entry.name not in known and not is_hidden and not entry.name.startswith("ledger."):
            report.add(Kind.FOREIGN, entry.name, "is no part of a dataset")


def _entries(directory: Path) -> Iterator[os.DirEntry[str]]:
    try:
        with os.scandir(directory) as entries:
            yield from sorted(entries, key=lambda entry: entry.name)
    except FileNotFoundError:
        return


def _check_tables(dataset: Dataset, rows: dict[str, EpisodeSummary], report: Report) -> None:
    meta = dataset.meta
    if meta.plan.digest != meta.plan_digest:
        report.add(Kind.CONTRADICTION, META_FILE, f"plan digest {meta.plan_digest}, its plan has {meta.plan.digest}")
    if meta.episodes != len(rows):
        report.add(Kind.CONTRADICTION, META_FILE, f"{meta.episodes} episodes, {METADATA_FILE} has {len(rows)}")
    if meta.complete and meta.dataset_digest != dataset.digest:
        text = f"dataset digest {meta.dataset_digest}, {METADATA_FILE} gives {dataset.digest}"
        report.add(Kind.CONTRADICTION, META_FILE, text)
    try:
        attempts = pq.read_metadata(dataset.root / ATTEMPTS_FILE).num_rows
        pq.read_table(dataset.root / ATTEMPTS_FILE)
    except FileNotFoundError:
        report.add(Kind.MISSING, ATTEMPTS_FILE, "is not there")
    except (pa.ArrowException, OSError) as error:
        report.add(Kind.DAMAGED, ATTEMPTS_FILE, f"cannot be read: {error}")
    else:
        if attempts != meta.failed_attempts:
            report.add(Kind.CONTRADICTION, ATTEMPTS_FILE, f"{attempts} rows, {META_FILE} says {meta.failed_attempts}")
    if not (dataset.root / CARD_FILE).is_file():
        report.add(Kind.MISSING, CARD_FILE, "is not there")


def _check_scenes(root: Path, meta: DatasetMeta, report: Report) -> dict[str, SceneEntry]:
    found: dict[str, SceneEntry] = {}
    expected = {f"{name}-{sha256[:16]}.scene.zip": (name, sha256) for name, sha256 in meta.scenes.items()}
    for entry in _entries(root / SCENES):
        if entry.name not in expected:
            report.add(Kind.FOREIGN, f"{SCENES}/{entry.name}", f"{META_FILE} does not name it")
    for file, (name, sha256) in expected.items():
        try:
            scene = read_entry(root / SCENES / file)
        except FileNotFoundError:
            report.add(Kind.MISSING, f"{SCENES}/{file}", "is not there")
        except (InvalidBundle, OSError) as error:
            report.add(Kind.DAMAGED, f"{SCENES}/{file}", str(error))
        else:
            if scene.sha256 == sha256:
                found[name] = scene
            else:
                report.add(Kind.CHANGED, f"{SCENES}/{file}", f"SHA-256 {scene.sha256}, recorded {sha256}")
    return found


def _check_episode(root: Path, row: EpisodeSummary, scenes: dict[str, SceneEntry], report: Report) -> None:
    path = root / row.file_name
    try:
        with path.open("rb") as file:
            sha256 = hashlib.file_digest(file, "sha256").hexdigest()
            size = file.tell()
            if size != row.file_bytes:
                report.add(Kind.TRUNCATED, row.file_name, f"{size} bytes, recorded {row.file_bytes}")
            elif sha256 != row.file_sha256:
                report.add(Kind.CHANGED, row.file_name, f"SHA-256 {sha256}, recorded {row.file_sha256}")
            if report.deep:
                with BundleReader(file) as bundle:
                    report.add(Kind.INVALID, row.file_name, *validate(bundle, target=_target(row, scenes, report)))
                    report.add(
                        Kind.CONTRADICTION, row.file_name, *_row_findings(row, summary_of(bundle.meta, sha256, size))
                    )
    except FileNotFoundError:
        report.add(Kind.MISSING, row.file_name, "is not there")
    except InvalidBundle as error:
        report.add(Kind.INVALID, row.file_name, *error.findings)
    except OSError as error:
        report.add(Kind.DAMAGED, row.file_name, f"cannot be read: {error}")


def _target(row: EpisodeSummary, scenes: dict[str, SceneEntry], report: Report) -> Target | None:
    scene = scenes.get(row.scene)
    if scene is None:
        return None  # the scene itself is a finding already
    if scene.sha256 != row.scene_sha256:
        text = f"made in a scene with SHA-256 {row.scene_sha256}, {row.scene} has {scene.sha256}"
        report.add(Kind.CONTRADICTION, row.file_name, text)
        return None
    try:
        return scene.info.target(row.target_id)
    except KeyError:
        report.add(Kind.CONTRADICTION, row.file_name, f"its target {row.target_id} is not in the scene {row.scene}")
        return None


def _row_findings(row: EpisodeSummary, found: EpisodeSummary) -> list[str]:
    return [
        f"{name}: {METADATA_FILE} says {getattr(row, name)}, the episode {getattr(found, name)}"
        for name in EpisodeSummary.model_fields
        if name not in {"file_sha256", "file_bytes"} and getattr(row, name) != getattr(found, name)
    ]


def _check_quotas(meta: DatasetMeta, rows: dict[str, EpisodeSummary], report: Report) -> None:
    """Compares the counts of every cell with the plan; an unfinished dataset may only have too few."""
    found = Counter((row.scene, row.split, row.spawn_tier) for row in rows.values())
    wanted = {
        (scene.name, split, tier): count
        for scene in meta.plan.scenes
        for (split, tier), count in cells(meta.plan, scene).items()
    }
    for key in sorted(found.keys() | wanted.keys()):
        have, want = found.get(key, 0), wanted.get(key, 0)
        if have > want or (meta.complete and have < want):
            report.add(Kind.CONTRADICTION, METADATA_FILE, f"{'/'.join(key)}: {have} episodes, the plan has {want}")
    runs = sorted({row.plan_digest for row in rows.values()} - {meta.plan_digest})
    if runs:
        report.add(Kind.CONTRADICTION, METADATA_FILE, f"episodes of other plans: {', '.join(runs)}")
