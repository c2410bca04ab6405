"""Output directory of an export: stages, syncs and renames pieces and files atomically. Independent of the format.

Every file under its final name is complete. Unfinished files are in the hidden folder `.export`, which is deleted last.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import hashlib
import os
import shutil
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager
from pathlib import Path

from schemas.errors import WorldError
from schemas.storage.disk import replacing, sync_directory, sync_file, translated, world_error
from schemas.support.closing import Closing

WORK_FOLDER = ".export"
_PIECES, _FACTS, _STAGING, _JOURNAL = "pieces", "facts", "staging", "finished"
_FEW_FILES = 16


class Output(Closing):
    """Opened output directory, locked against other exports.

    Raises:
        WorldError: the directory cannot be written, or another export has locked it.
    """

    def __init__(self, root: Path) -> None:
        self.root = root
        self._work = root / WORK_FOLDER
        self._done: set[str] = set()
        self.before_file: Callable[[], None] = lambda: None
        """Callback before each final file is written; may raise to interrupt the export."""
        with translated("open", root):
            root.mkdir(parents=True, exist_ok=True)
            self._lock = _lock(root)
        try:
            with translated("open", root):
                self._clear_staging()
                for name in (_PIECES, _FACTS, _STAGING):
                    (self._work / name).mkdir(parents=True, exist_ok=True)
        except WorldError:
            self.close()
            raise

    def staging_folder(self, name: str) -> Path:
        """Returns the path of the staging folder of a piece; it does not exist yet."""
        return self._work / _STAGING / name

    def piece_folder(self, episode_id: str) -> Path:
        """Returns the folder in which the piece of an episode is kept for `finish`."""
        return self._work / _PIECES / episode_id

    def facts_path(self, episode_id: str) -> Path:
        """Returns the path of the facts of an episode; the file exists if the piece is complete."""
        return self._work / _FACTS / f"{episode_id}.json"

    def accept(self, episode_id: str, staged: Path, facts: str, assembles: bool) -> None:
        """Accepts a complete, synced piece: moves its files out of the staging folder, then writes its facts.

        Args:
            episode_id: id of the episode.
            staged: staging folder of the piece.
            facts: facts of the piece as JSON.
            assembles: whether the piece is kept in `piece_folder` for `finish`; otherwise, its files are moved to their
                final paths.

        Raises:
            WorldError: the disk is full or not available; the piece must be exported again.
        """
        with translated("write", self.root):
            if assembles:
                place = self.piece_folder(episode_id)
                if place.exists():
                    shutil.rmtree(place)
                staged.rename(place)
                sync_directory(place.parent)
            else:
                _merge(staged, self.root)
                shutil.rmtree(staged, ignore_errors=True)
            with self._staged(self.facts_path(episode_id)) as part:
                part.write_text(facts, encoding="utf-8")

    def begin_finish(self, pieces: Iterable[str]) -> None:
        """Opens the journal of finished files.

        If the journal belongs to other pieces, deletes the files that it lists and starts a new journal.
        """
        digest = hashlib.sha256("\n".join(pieces).encode()).hexdigest()
        lines = self._read_journal()
        if lines[:1] == [digest]:
            self._done = set(lines[1:])
            return
        for name in lines[1:]:
            (self.root / name).unlink(missing_ok=True)
        self._done = set()
        with self._staged(self._work / _JOURNAL) as part:
            part.write_text(f"{digest}\n", encoding="utf-8")

    def has(self, name: str) -> bool:
        """Returns whether an earlier, interrupted `finish` with the same pieces has written a file completely."""
        return name in self._done and (self.root / name).is_file()

    @contextlib.contextmanager
    def replacing(self, name: str) -> Iterator[Path]:
        """Yields the path of a temporary file that is renamed to `name` when the block ends without an error.

        Args:
            name: path relative to the root, with `/` as separator; folders are created.

        Raises:
            WorldError: the disk is full or not available; no partial file remains.
        """
        self.before_file()
        final = self.root / name
        with translated("write", final):
            final.parent.mkdir(parents=True, exist_ok=True)
        with self._staged(final) as part:
            yield part
        self._note(name)

    def write_text(self, name: str, text: str) -> None:
        with self.replacing(name) as part:
            part.write_text(text, encoding="utf-8")

    def link(self, source: Path, name: str) -> None:
        """Creates a hard link of a file of a piece, or a copy if the file system has no hard links."""
        with self.replacing(name) as part:
            try:
                os.link(source, part)
            except OSError as error:
                if error.errno not in {errno.EPERM, errno.EOPNOTSUPP, errno.EMLINK, errno.EXDEV, errno.ENOSYS}:
                    raise
                shutil.copyfile(source, part)

    def size_bytes(self) -> int:
        """Returns the total size of all finished files, bytes."""
        files = (Path(folder) / name for folder, _, names in self._walk() for name in names)
        return sum(file.stat().st_size for file in files)

    def drop_work(self) -> None:
        """Deletes the working files; the export is then complete."""
        with translated("delete from", self.root):
            shutil.rmtree(self._work)
            sync_directory(self.root)

    def close(self) -> None:
        """Deletes partial pieces and unlocks the directory."""
        if self._lock is not None:
            with contextlib.suppress(OSError):
                self._clear_staging()
            os.close(self._lock)
            self._lock = None

    def _clear_staging(self) -> None:
        if (self._work / _STAGING).exists():
            shutil.rmtree(self._work / _STAGING)

    def _staged(self, final: Path) -> AbstractContextManager[Path]:
        return replacing(final, part=self._work / _STAGING / f"{final.name}.part", durable=True)

    def _note(self, name: str) -> None:
        journal = self._work / _JOURNAL
        if name in self._done or not journal.exists():
            return
        with translated("write", journal), journal.open("a", encoding="utf-8") as file:
            file.write(f"{name}\n")
            file.flush()
            os.fsync(file.fileno())
        self._done.add(name)

    def _read_journal(self) -> list[str]:
        journal = self._work / _JOURNAL
        text = journal.read_text(encoding="utf-8") if journal.exists() else ""
        return text[: text.rfind("\n") + 1].splitlines()

    def _walk(self) -> Iterator[tuple[str, list[str], list[str]]]:
        for folder, folders, names in os.walk(self.root):
            folders[:] = [name for name in folders if name != WORK_FOLDER]
            yield folder, folders, names


def sync_tree(folder: Path) -> None:
    """Syncs all files and directory entries below a folder to disk."""
    folders = [(Path(place), names) for place, _, names in os.walk(folder)]
    files = [place / name for place, names in folders for name in names]
    if len(files) > _FEW_FILES:
        os.sync()  # one call for all files; `sync_file` takes 7 ms per file
        return
    for file in files:
        sync_file(file)
    for place, _ in folders:
        sync_directory(place)


def _merge(source: Path, target: Path) -> None:
    """Moves the entries of a folder into another by renaming; merges folders that exist in both."""
    for entry in sorted(source.iterdir()):
        place = target / entry.name
        if entry.is_dir() and place.is_dir():
            _merge(entry, place)
        else:
            entry.rename(place)
    sync_directory(target)


def _lock(root: Path) -> int | None:
    descriptor = os.open(root, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        os.close(descriptor)
        raise WorldError(f"another export is writing to {root}: wait until it ends, or choose another --out") from error
    except OSError as error:
        os.close(descriptor)
        raise world_error("lock", root, error) from error
    return descriptor
