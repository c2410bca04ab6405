"""Archive in a directory: each step is durable before the next one begins (docs/design/data.md#archive).

The module does not overwrite an episode, derives no path from an untrusted name and does not read bundle contents.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import threading
from collections.abc import Collection, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from coordinator.archive.packing import PackingArchive
from coordinator.archive.scenes import SceneStore
from coordinator.archive.staging import PartFile, Staging
from schemas.dataset.rows import file_name_of
from schemas.errors import FactoryError, WorldError
from schemas.job import episode_id, index_of_file
from schemas.storage.dataset_files import EPISODES, QUARANTINE, SCENES
from schemas.storage.disk import (
    replacing,
    set_aside,
    set_copy_aside,
    sync_directory,
    translated,
)
from schemas.storage.packed_path import PackedPath
from schemas.storage.place import Place
from schemas.support.closing import Closing

_SYNCING_THREADS = 8
"""Number of threads that sync the files of several episodes; the file system commits concurrent syncs together."""


class DirectoryArchive(PackingArchive, SceneStore, Closing):
    """Exclusively opened dataset directory: no other coordinator can open it until it is closed.

    Raises:
        WorldError: the directory cannot be written, or another coordinator holds it.
    """

    root: Path

    def __init__(self, root: Path) -> None:
        super().__init__()
        self.root = root
        self._publishing = threading.Lock()
        self._syncing = ThreadPoolExecutor(_SYNCING_THREADS, "sync")
        self._staging = Staging(root, str(root))
        try:
            with translated("open", root):
                for name in (EPISODES, SCENES, QUARANTINE):
                    (root / name).mkdir(exist_ok=True)
                sync_directory(root)
            self._open_shards()
        except WorldError:
            self.close()
            raise

    def stage(self, index: int) -> PartFile:
        return self._staging.stage(index)

    def publish(self, staged: PartFile, index: int) -> Path:
        """Publishes a part file: fsync, rename, fsync of the directory. The ledger commits afterwards.

        Raises:
            ArchiveCorrupt: a file of that name exists; it is not changed, and the part file is removed.
            WorldError: the disk is full or unavailable; no incomplete file remains.
        """
        for error in self.publish_all({index: staged}).values():
            raise error
        return self._file_of(index)

    def publish_all(self, parts: Mapping[int, PartFile]) -> dict[int, FactoryError]:
        """See `Archive.publish_all`. The folder is synced once; the files are synced by several threads."""
        failed = dict(self._flush_all(parts))
        with self._publishing:
            for index, staged in parts.items():
                with staged:
                    try:
                        if index not in failed:
                            self._rename(staged, index)
                    except FactoryError as error:
                        failed[index] = error
            if len(failed) < len(parts):
                with translated("rename into", self.root / EPISODES):
                    sync_directory(self.root / EPISODES)
        return failed

    def _flush_all(self, parts: Mapping[int, PartFile]) -> Iterator[tuple[int, FactoryError]]:
        """Syncs part files. Yields episode number and error for each part file that cannot be synced."""
        errors = map(_flush, parts.values()) if len(parts) == 1 else self._syncing.map(_flush, parts.values())
        for index, error in zip(parts, errors, strict=True):
            if error is not None:
                yield index, error

    def _rename(self, staged: PartFile, index: int) -> None:
        self._require_free(index)
        final = self._file_of(index)
        with translated("rename into", final.parent):
            staged.path.rename(final)

    def _file_of(self, index: int) -> Path:
        return self.root / file_name_of(episode_id(index))

    def _listing(self) -> Iterator[tuple[int | None, Path]]:
        with os.scandir(self.root / EPISODES) as entries:
            for entry in entries:
                is_file = entry.is_file(follow_symlinks=False)
                yield index_of_file(entry.name) if is_file else None, Path(entry.path)

    def _store_shard(self, part: Path, name: str) -> None:
        folder = self.root / EPISODES
        with translated("rename into", folder):
            part.rename(folder / name)
            sync_directory(folder)

    def _delete(self, places: Collection[Place]) -> None:
        folder = self.root / EPISODES
        with translated("delete from", folder):
            for place in places:
                (folder / place.name).unlink(missing_ok=True)
            if places:
                sync_directory(folder)

    def _set_aside(self, path: Place, reason: str) -> Path:
        assert isinstance(path, Path), path
        return set_aside(path, self.root / QUARANTINE, reason)

    def _keep_copy(self, path: PackedPath, reason: str) -> Path:
        return set_copy_aside(path.read_bytes(checked=False), str(path), self.root / QUARANTINE, reason)

    def restore(self, path: Place, index: int) -> Path:
        assert isinstance(path, Path), path
        final = self._file_of(index)
        with self._publishing, translated("move into", final.parent):
            self._require_free(index)
            path.rename(final)
            path.with_name(f"{path.name}.reason.txt").unlink(missing_ok=True)
            sync_directory(final.parent)
            sync_directory(path.parent)
        return final

    def free_bytes(self) -> int:
        return self._staging.free_bytes()

    def _keep(self, source: Path, place: Place) -> None:
        assert isinstance(place, Path), place
        with translated("write", place):
            if not place.parent.is_dir():
                place.parent.mkdir()
                sync_directory(place.parent.parent)
        with replacing(place, part=self._staging.part(place.name), durable=True) as part:
            shutil.copyfile(source, part)

    def _drop(self, place: Place) -> None:
        assert isinstance(place, Path), place
        with translated("delete from", place.parent):
            place.unlink(missing_ok=True)

    @contextlib.contextmanager
    def replacing(self, name: str) -> Iterator[Path]:
        """Yields the path of a part file, which replaces a table of the dataset if the block exits without an error.

        Args:
            name: path relative to the dataset directory, e.g. `metadata.parquet` or `data/train_id-00000.parquet`.

        Raises:
            WorldError: the disk is full or unavailable; the previous file is unchanged.
        """
        final = self.root / name
        with translated("write", final):
            if not final.parent.is_dir():
                final.parent.mkdir()
                sync_directory(self.root)
        with replacing(final, part=self._staging.part(final.name), durable=True) as part:
            yield part

    def close(self) -> None:
        """Releases the directory, so another coordinator can open it."""
        self._syncing.shutdown()
        self._staging.close()


def _flush(staged: PartFile) -> FactoryError | None:
    try:
        staged.flush()
    except WorldError as error:
        return error
    return None
