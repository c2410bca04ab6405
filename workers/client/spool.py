"""The spool: finished bundles on disk until the coordinator has them, across restarts of the worker.

Never asks anybody what to keep; it is told what to drop.
"""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import os
import shutil
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import structlog
from pydantic import Field, ValidationError

from schemas.base import Bytes, Model, Sha256
from schemas.errors import WorldError
from schemas.support.closing import Closing
from schemas.support.log_limit import Repeated
from schemas.wire import Lease

__all__ = ["Spool", "Spooled", "find_bundle", "folder_of"]

_MAX_SIBLINGS = 256
_FOLDER_MODE, _FILE_MODE = 0o700, 0o600
"""A sidecar holds the token of a lease."""
_LOCK, _PART, _BUNDLE, _SIDECAR = "lock", ".part", ".zip", ".json"

log = structlog.get_logger(__name__)


def folder_of(root: Path, run: str) -> Path:
    """Returns the folder of a run under a root; it is named by digest, for the run's name came over the network."""
    return root / hashlib.sha256(run.encode()).hexdigest()[:16]


def find_bundle(folder: Path, lease: Lease) -> Path | None:
    """Returns the finished bundle made under a lease that some worker keeps in a run's folder, or `None`."""
    for sidecar in folder.glob(f"*/{_stem(lease)}{_SIDECAR}"):
        entry = _read_sidecar(sidecar)
        if entry is not None and entry.lease == lease:
            return sidecar.with_suffix(_BUNDLE)
    return None


class Spooled(Model):
    """The sidecar of a finished bundle: all that its announcement says."""

    lease: Lease
    sha256: Sha256
    size: Annotated[Bytes, Field(ge=1)]


class Spool(Closing):
    """A locked folder of bundles; a context manager.

    Takes the first folder under `root` that no living worker uses, and with it what dead workers left in the others.

    Args:
        root: folder of the run; made when missing.
        max_bundles: from this many on the spool is full.
        max_bytes: the same in bytes.
        min_free_bytes: below this much free space the spool is full, whatever it holds.

    Raises:
        WorldError: the folder cannot be written.
    """

    def __init__(self, root: Path, max_bundles: int, max_bytes: int, min_free_bytes: int = 0) -> None:
        self._max_bundles, self._max_bytes, self._min_free_bytes = max_bundles, max_bytes, min_free_bytes
        self._guard = threading.Lock()
        self._short = Repeated(log.bind(remedy="free some space; the worker then continues"), "spool_disk_low")
        try:
            self.directory, self._lock = _take_folder(root)
            for orphaned in _idle_siblings(root, self.directory):
                _adopt(orphaned, self.directory)
            self._entries = {_key(entry.lease): entry for entry in _clean(self.directory)}
        except OSError as error:
            raise WorldError(f"cannot spool in {root}: {error}; choose a writable folder with --spool") from error

    @property
    def is_full(self) -> bool:
        """Whether no further attempt should begin; attempts under way still find room.

        Raises:
            WorldError: the folder is gone or cannot be used.
        """
        with self._guard:
            held, size = len(self._entries), sum(entry.size for entry in self._entries.values())
        return held >= self._max_bundles or size >= self._max_bytes or self._is_disk_short()

    def _is_disk_short(self) -> bool:
        with self._translated():
            free = shutil.disk_usage(self.directory).free
        if free >= self._min_free_bytes:
            self._short.succeed()
            return False
        self._short.fail(f"{free} bytes free, {self._min_free_bytes} required", spool=str(self.directory))
        return True

    def path_for(self, lease: Lease) -> Path:
        """Returns where the bundle made under a lease has to lie before it is added."""
        with self._guard:
            stranger = self._entries.get(_key(lease))
        if stranger is not None and stranger.lease != lease:  # of a former ledger under the same name of run
            self.drop(stranger.lease)
        return self._file(lease, _BUNDLE)

    def clear(self, lease: Lease) -> None:
        """Removes what an attempt without a bundle has left at `path_for(lease)`.

        Raises:
            WorldError: the folder cannot be used.
        """
        with self._guard:
            if _key(lease) in self._entries:
                return
        bundle = self._file(lease, _BUNDLE)
        with self._translated():
            bundle.unlink(missing_ok=True)
            bundle.with_name(bundle.name + _PART).unlink(missing_ok=True)

    def add(self, lease: Lease, sha256: str, size: int) -> Spooled:
        """Takes a bundle that lies whole and synced at `path_for(lease)`; from now on it survives a crash.

        Raises:
            WorldError: the disk does not take the note about it.
        """
        entry = Spooled(lease=lease, sha256=sha256, size=size)
        with self._translated():
            _write_synced(self._file(lease, _SIDECAR), entry.model_dump_json().encode())
        with self._guard:
            self._entries[_key(lease)] = entry
        return entry

    def entries(self) -> tuple[Spooled, ...]:
        """Returns what waits, oldest first."""
        with self._guard:
            return tuple(self._entries.values())

    def drop(self, lease: Lease) -> bool:
        """Deletes a bundle that is wanted no more; returns whether it was there.

        Raises:
            WorldError: the folder cannot be used.
        """
        with self._guard:
            entry = self._entries.get(_key(lease))
            if entry is None or entry.lease != lease:
                return False
            del self._entries[_key(lease)]
        # the sidecar goes first: a bundle without one is removed at the next start
        with self._translated():
            self._file(lease, _SIDECAR).unlink(missing_ok=True)
            self._file(lease, _BUNDLE).unlink(missing_ok=True)
        return True

    def read(self, job_id: int, fence: int, offset: int, length: int) -> bytes:
        """Returns bytes of a bundle, fewer than asked for at its end.

        A bundle that was deleted or cut from outside is forgotten: its lease runs out, and it is made again.

        Raises:
            KeyError: no such bundle waits here.
        """
        with self._guard:
            entry = self._entries[job_id, fence]
        try:
            data = _read_range(self._file(entry.lease, _BUNDLE), offset, length)
        except OSError as error:
            self._forget(entry, str(error))
            raise KeyError((job_id, fence)) from error
        if len(data) < min(length, entry.size - offset):
            self._forget(entry, f"{offset + len(data)} bytes are left of {entry.size}")
            raise KeyError((job_id, fence))
        return data

    def close(self) -> None:
        """Lets another worker have the folder; the bundles stay."""
        if self._lock >= 0:
            os.close(self._lock)
            self._lock = -1

    def __len__(self) -> int:
        with self._guard:
            return len(self._entries)

    def _forget(self, entry: Spooled, why: str) -> None:
        with self._guard:
            self._entries.pop(_key(entry.lease), None)
        log.warning("bundle_lost", job=entry.lease.job_id, why=why, remedy="none; its job is done again")

    @contextlib.contextmanager
    def _translated(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise WorldError(
                f"the spool {self.directory} cannot be used: {error.strerror or error}; restart the worker, which "
                "creates the folder again, free some space, or choose another folder with --spool"
            ) from error

    def _file(self, lease: Lease, suffix: str) -> Path:
        return self.directory / f"{_stem(lease)}{suffix}"


def _read_range(path: Path, offset: int, length: int) -> bytes:
    descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        return os.pread(descriptor, length, offset)
    finally:
        os.close(descriptor)


def _key(lease: Lease) -> tuple[int, int]:
    return lease.job_id, lease.fence


def _stem(lease: Lease) -> str:
    return f"{lease.job_id}.{lease.fence}"


def _take_folder(root: Path) -> tuple[Path, int]:
    for number in range(_MAX_SIBLINGS):
        folder = root / str(number)
        folder.mkdir(mode=_FOLDER_MODE, parents=True, exist_ok=True)
        folder.chmod(_FOLDER_MODE)  # one of an older version could be read by everybody
        lock = _try_lock(folder)
        if lock is not None:
            return folder, lock
    raise WorldError(f"{_MAX_SIBLINGS} workers use spool folders below {root}; choose another folder with --spool")


def _try_lock(folder: Path) -> int | None:
    descriptor = os.open(folder / _LOCK, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, _FILE_MODE)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(descriptor)
        return None
    return descriptor


@contextlib.contextmanager
def _locked(folder: Path) -> Iterator[bool]:
    descriptor = _try_lock(folder)
    try:
        yield descriptor is not None
    finally:
        if descriptor is not None:
            os.close(descriptor)


def _idle_siblings(root: Path, mine: Path) -> list[Path]:
    return [path for path in sorted(root.iterdir()) if path.is_dir() and path != mine and (path / _LOCK).exists()]


def _adopt(orphaned: Path, mine: Path) -> None:
    with _locked(orphaned) as is_idle:
        if not is_idle:
            return
        for entry in _clean(orphaned):
            stem = _stem(entry.lease)
            if (mine / f"{stem}{_SIDECAR}").exists():
                continue
            for suffix in (_BUNDLE, _SIDECAR):  # the sidecar last: it makes the bundle count
                (orphaned / f"{stem}{suffix}").rename(mine / f"{stem}{suffix}")
            log.info("bundle_adopted", job=entry.lease.job_id, fence=entry.lease.fence)


def _clean(folder: Path) -> list[Spooled]:
    """Removes what a crash left half done; returns what is whole, oldest first."""
    whole = {}
    for sidecar in sorted(folder.glob(f"*{_SIDECAR}"), key=lambda path: path.stat().st_mtime_ns):
        entry = _read_sidecar(sidecar)
        bundle = sidecar.with_suffix(_BUNDLE)
        if entry is not None and bundle.is_file() and bundle.stat().st_size == entry.size:
            whole[sidecar.stem] = entry
    for path in folder.iterdir():
        if path.name != _LOCK and not (path.stem in whole and path.suffix in {_BUNDLE, _SIDECAR}):
            path.unlink(missing_ok=True)
    return list(whole.values())


def _read_sidecar(path: Path) -> Spooled | None:
    try:
        entry = Spooled.model_validate_json(path.read_bytes())
    except ValidationError:
        return None
    return entry if path.stem == _stem(entry.lease) else None


def _write_synced(path: Path, data: bytes) -> None:
    part = path.with_name(path.name + _PART)
    part.unlink(missing_ok=True)
    with os.fdopen(os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, _FILE_MODE), "wb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())
    part.rename(path)
    descriptor = os.open(path.parent, os.O_RDONLY | os.O_CLOEXEC)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
