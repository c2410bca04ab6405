"""Spool: stores finished bundles on disk until the coordinator has archived them, across restarts of the worker.

Does not decide which bundles to keep; the caller drops them.
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

import structlog
from pydantic import ValidationError

from schemas.errors import WorldError
from schemas.protocol.messages import Lease, SpooledBundle
from schemas.support.closing import Closing
from schemas.support.log_limit import Repeated

_MAX_SIBLINGS = 256
_FOLDER_MODE, _FILE_MODE = 0o700, 0o600
"""Permissions that give access to the owner only, because a sidecar contains the token of a lease."""
_LOCK, _PART, _BUNDLE, _SIDECAR = "lock", ".part", ".zip", ".json"

log = structlog.get_logger(__name__)


def folder_of(root: Path, run: str) -> Path:
    """Returns the folder of a run under a root; its name is a digest, because the run's name comes from the network."""
    return root / hashlib.sha256(run.encode()).hexdigest()[:16]


def find_bundle(folder: Path, lease: Lease) -> Path | None:
    """Returns the path of the finished bundle of a lease, in the spool of any worker of a run, or `None`."""
    for sidecar in folder.glob(f"*/{_stem(lease)}{_SIDECAR}"):
        entry = _read_sidecar(sidecar)
        if entry is not None and entry.lease == lease:
            return sidecar.with_suffix(_BUNDLE)
    return None


class Spool(Closing):
    """Locked folder of bundles; a context manager.

    Uses the first folder under `root` that no running worker has locked, and moves the bundles of all other unlocked
    folders into it.

    Args:
        root: folder of the run; it is created if missing.
        max_bundles: number of bundles at which the spool is full.
        max_bytes: size at which the spool is full, bytes.
        min_free_bytes: free space of the disk below which the spool is full, bytes.

    Raises:
        WorldError: the folder cannot be written.
    """

    def __init__(self, root: Path, max_bundles: int, max_bytes: int, min_free_bytes: int = 0) -> None:
        self._max_bundles, self._max_bytes, self._min_free_bytes = max_bundles, max_bytes, min_free_bytes
        self._guard = threading.Lock()
        self._disk_low = Repeated(log.bind(remedy="free some space; the worker then continues"), "spool_disk_low")
        try:
            self.directory, self._lock = _take_folder(root)
            for orphaned in _idle_siblings(root, self.directory):
                _adopt(orphaned, self.directory)
            self._entries = {_key(entry.lease): entry for entry in _clean(self.directory)}
        except OSError as error:
            raise WorldError(f"cannot spool in {root}: {error}; choose a writable folder with --spool") from error

    @property
    def is_full(self) -> bool:
        """Whether no new attempt should start; bundles of current attempts can still be added.

        Raises:
            WorldError: the folder is missing or cannot be used.
        """
        with self._guard:
            held, size = len(self._entries), sum(entry.size for entry in self._entries.values())
        return held >= self._max_bundles or size >= self._max_bytes or self._is_disk_short()

    def _is_disk_short(self) -> bool:
        with self._translated():
            free = shutil.disk_usage(self.directory).free
        if free >= self._min_free_bytes:
            self._disk_low.succeed()
            return False
        self._disk_low.fail(f"{free} bytes free, {self._min_free_bytes} required", spool=str(self.directory))
        return True

    def path_for(self, lease: Lease) -> Path:
        """Returns the path at which the caller writes the bundle of a lease before it calls `add`."""
        with self._guard:
            previous = self._entries.get(_key(lease))
        # a bundle with the same key and another lease is from an earlier ledger of a run with the same name
        if previous is not None and previous.lease != lease:
            self.drop(previous.lease)
        return self._file(lease, _BUNDLE)

    def clear(self, lease: Lease) -> None:
        """Removes the files that a failed attempt has left at `path_for(lease)`.

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

    def add(self, lease: Lease, sha256: str, size: int, *, is_validated: bool = False) -> SpooledBundle:
        """Adds the complete and synced bundle at `path_for(lease)`; from now on it survives a crash.

        Args:
            lease: lease of the job.
            sha256: SHA-256 of the bundle.
            size: size of the bundle, bytes.
            is_validated: whether the worker has validated the bundle.

        Raises:
            WorldError: the sidecar cannot be written.
        """
        entry = SpooledBundle(lease=lease, sha256=sha256, size=size, is_validated=is_validated)
        with self._translated():
            _write_synced(self._file(lease, _SIDECAR), entry.model_dump_json().encode())
        with self._guard:
            self._entries[_key(lease)] = entry
        return entry

    def entries(self) -> tuple[SpooledBundle, ...]:
        """Returns the bundles in the spool, oldest first."""
        with self._guard:
            return tuple(self._entries.values())

    def drop(self, lease: Lease) -> bool:
        """Deletes the bundle of a lease; returns whether the spool contained it.

        Raises:
            WorldError: the folder cannot be used.
        """
        with self._guard:
            entry = self._entries.get(_key(lease))
            if entry is None or entry.lease != lease:
                return False
            del self._entries[_key(lease)]
        # the sidecar is deleted first, because a bundle without a sidecar is removed at the next start
        with self._translated():
            self._file(lease, _SIDECAR).unlink(missing_ok=True)
            self._file(lease, _BUNDLE).unlink(missing_ok=True)
        return True

    def read(self, job_id: int, fence: int, offset: int, length: int) -> bytes:
        """Returns bytes of a bundle, fewer than requested at its end.

        A bundle that another process deleted or truncated is removed from the spool; its lease expires, and its job
        runs again.

        Raises:
            KeyError: the spool does not contain the bundle.
        """
        with self._guard:
            entry = self._entries[job_id, fence]
        try:
            data = _read_range(self._file(entry.lease, _BUNDLE), offset, length)
        except OSError as error:
            self._forget(entry, str(error))
            raise KeyError((job_id, fence)) from error
        if len(data) < min(length, entry.size - offset):
            self._forget(entry, f"it has {offset + len(data)} bytes instead of {entry.size}")
            raise KeyError((job_id, fence))
        return data

    def close(self) -> None:
        if self._lock >= 0:
            os.close(self._lock)
            self._lock = -1

    def __len__(self) -> int:
        with self._guard:
            return len(self._entries)

    def _forget(self, entry: SpooledBundle, why: str) -> None:
        with self._guard:
            self._entries.pop(_key(entry.lease), None)
        log.warning("bundle_lost", job=entry.lease.job_id, why=why, remedy="not needed; the job runs again")

    @contextlib.contextmanager
    def _translated(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise WorldError(
                f"the spool {self.directory} cannot be used: {error.strerror or error}; restart the worker (it "
                "creates the folder again), free some space, or choose another folder with --spool"
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
        folder.chmod(_FOLDER_MODE)  # older versions created it readable for all users
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
            # the sidecar is moved last, because a bundle without a sidecar is deleted
            for suffix in (_BUNDLE, _SIDECAR):
                (orphaned / f"{stem}{suffix}").rename(mine / f"{stem}{suffix}")
            log.info("bundle_adopted", job=entry.lease.job_id, fence=entry.lease.fence)


def _clean(folder: Path) -> list[SpooledBundle]:
    """Removes incomplete files of a crashed worker; returns the complete bundles, oldest first."""
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


def _read_sidecar(path: Path) -> SpooledBundle | None:
    try:
        entry = SpooledBundle.model_validate_json(path.read_bytes())
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
