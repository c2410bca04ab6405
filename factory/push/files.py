"""Prepares a folder for upload: renders missing thumbnails; selects the files, their batches and the tag.

Does not use the network.
"""

from __future__ import annotations

import itertools
import json
import os
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from coordinator.archive.directory import DirectoryArchive
from coordinator.tables.split_tables import has_pictures, lacks_pictures, write_split_tables
from factory.dataset.reader import Dataset
from schemas.errors import UsageError, WorldError
from schemas.storage.dataset_files import EPISODES, META_FILE, QUARANTINE, SCENES, SPLITS_FOLDER, STAGING
from schemas.storage.place import children

BATCH_FILES = 400
"""Maximum number of files in one commit; the Hub advises against many more."""
BATCH_BYTES = 5_000_000_000
"""Maximum size of one commit, bytes, unless a single file is larger."""
_MAX_FILES_A_FOLDER = 10_000
"""Maximum number of entries in a folder, set by the Hub."""
_LEROBOT_INFO = Path("meta/info.json")
_JSON_BYTES = 16 << 20
"""Maximum size of a description file that is read, bytes; a larger file is treated as empty."""
_DATASET_FOLDERS = (EPISODES, SCENES, SPLITS_FOLDER)
_REPOSITORY = re.compile(r"[A-Za-z0-9][\w.-]{0,95}/[A-Za-z0-9][\w.-]{0,95}", re.ASCII)
_VERSION = re.compile(r"v\d+\.\d+")


@dataclass(frozen=True)
class PushFile:
    """File to upload."""

    path: Path
    """Local path."""
    name: str
    """Path in the repository, with forward slashes."""
    size: int
    """Size of the file, bytes."""


@dataclass(frozen=True)
class PushPlan:
    """Upload plan of one folder."""

    root: Path
    kind: str
    """`dataset` or `export`."""
    files: tuple[PushFile, ...]
    """Files in the order of upload: data first, then descriptions, so a description never precedes its data."""
    tag: str | None
    """Tag required by readers of the format: LeRobot's version, such as `v3.0`; `None` for other formats."""
    remarks: tuple[str, ...]
    """Warnings to show to the user before the upload."""

    @property
    def total_bytes(self) -> int:
        """Total size of all files, bytes."""
        return sum(file.size for file in self.files)


def lacks_thumbnails(root: Path) -> bool:
    """Returns whether a folder is a states dataset whose split tables have rows without thumbnails."""
    if not (root / META_FILE).is_file() or has_pictures(root):
        return False
    return any(lacks_pictures(table) for table in children(root / SPLITS_FOLDER))


def render_thumbnails(root: Path, on_progress: Callable[[int, int], None]) -> None:
    """Renders the missing thumbnails of a states dataset. They equal the thumbnails of a frames dataset.

    Args:
        root: Dataset directory.
        on_progress: Progress callback, called with the number of rendered thumbnails and the number of episodes.

    Raises:
        WorldError: A coordinator has locked the dataset, it cannot be written, or this machine cannot render.
        ArchiveCorrupt: A table, an episode or a scene is damaged.
    """
    # not at the end of a run, because the machine of a coordinator may have no graphics driver
    dataset, done = Dataset(root), itertools.count(1)

    def draw(episode_id: str) -> NDArray[np.uint8]:
        with dataset[episode_id] as episode:
            rgb = episode.rgb(0)
        on_progress(next(done), len(dataset))
        return rgb

    with DirectoryArchive(root) as archive:
        write_split_tables(archive, draw=draw)


def require_repository(name: str) -> str:
    """Returns a repository name after validating it.

    Raises:
        UsageError: The name does not have the form OWNER/NAME.
    """
    if not _REPOSITORY.fullmatch(name) or ".." in name or "--" in name:
        raise UsageError(f"{name!r} is not a valid repository; write OWNER/NAME, e.g. my-lab/office-navigation")
    return name


def plan_push(root: Path, manifest_name: str) -> PushPlan:
    """Returns the upload plan of a folder.

    Args:
        root: Dataset directory, or output of `factory export`.
        manifest_name: Name of the file that identifies an export.

    Raises:
        UsageError: The folder is neither a dataset nor an export.
        WorldError: The folder cannot be read, or it is empty.
    """
    kind = _kind_of(root, manifest_name)
    remarks: list[str] = []
    try:
        files = sorted(_walk(root, kind, remarks), key=lambda file: (_is_description(file.name), file.name))
    except OSError as error:
        raise WorldError(f"cannot list {root}: {error.strerror}") from error
    if not files:
        raise WorldError(f"{root} contains no files to upload")
    remarks += _incomplete(root / (META_FILE if kind == "dataset" else manifest_name), kind)
    remarks += _crowded(files)
    return PushPlan(root, kind, files=tuple(files), tag=_lerobot_version(root), remarks=tuple(remarks))


def batches_of(
    files: Sequence[PushFile], most_files: int = BATCH_FILES, most_bytes: int = BATCH_BYTES
) -> Iterator[tuple[PushFile, ...]]:
    """Yields batches of consecutive files, each small enough for one commit."""
    batch: list[PushFile] = []
    size = 0
    for file in files:
        if batch and (len(batch) == most_files or size + file.size > most_bytes):
            yield tuple(batch)
            batch, size = [], 0
        batch.append(file)
        size += file.size
    if batch:
        yield tuple(batch)


def _kind_of(root: Path, manifest_name: str) -> str:
    if (root / manifest_name).is_file():
        return "export"
    if (root / META_FILE).is_file():
        return "dataset"
    problem = f"neither {META_FILE} (a dataset) nor {manifest_name} (an export)"
    raise UsageError(f"{root} has {problem}: give the --out of `factory run` or of `factory export`")


def _walk(root: Path, kind: str, remarks: list[str]) -> Iterator[PushFile]:
    for folder, folders, names in os.walk(root):
        here = Path(folder)
        folders[:] = sorted(name for name in folders if _is_included(here == root, name, kind))
        for name in sorted(names):
            path = here / name
            relative = path.relative_to(root).as_posix()
            if path.is_symlink() or not path.is_file():
                remarks.append(f"{relative} is a link or not a regular file and is not uploaded")
            elif _goes(relative, name, kind):
                yield PushFile(path, relative, path.stat().st_size)
        for name in [name for name in folders if (here / name).is_symlink()]:
            remarks.append(f"{(here / name).relative_to(root).as_posix()} is a link and is not uploaded")


def _is_included(at_top: bool, name: str, kind: str) -> bool:
    if name.startswith(".") or name in (QUARANTINE, STAGING):
        return False
    return not at_top or kind == "export" or name in _DATASET_FOLDERS


def _goes(relative: str, name: str, kind: str) -> bool:
    """Returns whether to upload a file. Excludes the ledger, which names hosts, and hidden and temporary files."""
    if name.startswith(".") or name.endswith((".part", ".tmp")):
        return False
    at_top = "/" not in relative
    return not (kind == "dataset" and at_top) or relative.endswith((".md", ".parquet", ".json", ".yaml"))


def _is_description(name: str) -> bool:
    return "/" not in name or name.startswith("meta/")


def _incomplete(description: Path, kind: str) -> list[str]:
    meta = _read_json(description, _JSON_BYTES)
    if meta.get("complete") is not False:
        return []
    if kind == "dataset":
        lines = f"{meta.get('episodes')} of {meta.get('planned')} planned episodes"
        return [f"the dataset is not complete ({lines}): complete it with `factory run`, or push it again later"]
    return ["the export is not complete: run `factory export` again, or it is uploaded incomplete"]


def _crowded(files: Sequence[PushFile]) -> list[str]:
    counts: dict[str, int] = {}
    for file in files:
        folder = file.name.rpartition("/")[0]
        counts[folder] = counts.get(folder, 0) + 1
    return [
        f"{folder or '.'} has {count} files; the Hub allows {_MAX_FILES_A_FOLDER} in a folder: choose a sharded format"
        for folder, count in counts.items()
        if count > _MAX_FILES_A_FOLDER
    ]


def _lerobot_version(root: Path) -> str | None:
    version = _read_json(root / _LEROBOT_INFO, _JSON_BYTES).get("codebase_version")
    return version if isinstance(version, str) and _VERSION.fullmatch(version) else None


def _read_json(path: Path, most_bytes: int) -> dict[str, object]:
    try:
        if path.stat().st_size > most_bytes:
            return {}
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return content if isinstance(content, dict) else {}
