"""Archive in object storage: an episode is one conditional put of a local part file.

Part files and the lock file are stored in a local directory, the state directory. A lock object in the store names the
state directory whose coordinator may write. The lock object is created once and does not expire, so a coordinator
that was suspended for a while keeps the dataset. The module does not overwrite an episode and does not read bundle
contents.

Design: docs/design/protocol.md#the-lock-of-a-bucket-does-not-expire.
"""

from __future__ import annotations

import contextlib
import json
import mmap
import os
import secrets
import socket
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path

import structlog

from coordinator.archive.packing import PackingArchive, in_threads
from coordinator.archive.scenes import SceneStore
from coordinator.archive.staging import PartFile, Staging
from schemas.dataset.rows import file_name_of
from schemas.errors import ArchiveCorrupt, FactoryError, WorldError
from schemas.job import episode_id, index_of_file
from schemas.storage.dataset_files import EPISODES, QUARANTINE
from schemas.storage.disk import set_aside, translated
from schemas.storage.object_path import ObjectPath
from schemas.storage.packed_path import PackedPath
from schemas.storage.place import Place, digest_of
from schemas.support.closing import Closing
from schemas.support.shell import quoted

_LOCK = ".lock"
_NAME = ".name"
"""File that contains the random id of a state directory; the lock object contains the same id."""
log = structlog.get_logger(__name__)


class ObjectArchive(PackingArchive, SceneStore, Closing):
    """Exclusively opened dataset in object storage: no coordinator with another state directory can
    open it until it is closed.

    Args:
        root: root of the dataset.
        state_dir: local directory for part files; created if it does not exist. Always open a dataset with
            the same state directory.
        take_over: whether to delete the lock object of another state directory, whose coordinator must have ended.

    Raises:
        WorldError: the state directory or the store cannot be written, another coordinator holds either of them, or the
            store ignores conditional writes.
    """

    root: ObjectPath

    def __init__(self, root: ObjectPath, state_dir: Path, *, take_over: bool = False) -> None:
        super().__init__()
        self.root = root
        self._objects = root.objects
        self._state_dir = state_dir
        self._staging = Staging(state_dir, str(root))
        try:
            self._id = _id_of(state_dir)
            if take_over:
                self._objects.delete(_LOCK)
            self._lock()
        except WorldError:
            self._staging.close()
            raise
        try:
            self._open_shards()
        except WorldError:
            self.close()
            raise

    def stage(self, index: int) -> PartFile:
        return self._staging.stage(index)

    def publish(self, staged: PartFile, index: int) -> ObjectPath:
        """Uploads a part file to its final key in one conditional put. The ledger commits afterwards.

        If the response to a put was lost, the retry finds its own object: an object with the same bytes counts as
        published.

        Raises:
            ArchiveCorrupt: an object with other bytes has that key; it is not changed, and the part file is removed.
            WorldError: the store rejects the object; no incomplete object is visible.
        """
        final = self._file_of(index)
        with staged:
            if self._shards.find(index) is not None:
                self._require_free(index)
            try:
                self._put_new(final.key, staged.path)
            except FileExistsError:
                if final.stat().st_size != staged.size or digest_of(final) != staged.sha256:
                    self._require_free(index)
            stored_size = final.stat().st_size
            if stored_size != staged.size:
                raise ArchiveCorrupt(
                    f"{final} has {stored_size} bytes, but {staged.size} were sent: run `factory repair`"
                )
        return final

    def publish_all(self, parts: Mapping[int, PartFile]) -> dict[int, FactoryError]:
        """See `Archive.publish_all`. Some objects are put at the same time."""
        errors = in_threads(lambda part: self._error_of(*part), parts.items())
        return {index: error for index, error in zip(parts, errors, strict=True) if error is not None}

    def _error_of(self, index: int, staged: PartFile) -> FactoryError | None:
        try:
            self.publish(staged, index)
        except FactoryError as error:
            return error
        return None

    def _file_of(self, index: int) -> ObjectPath:
        return self.root / file_name_of(episode_id(index))

    def _listing(self) -> Iterator[tuple[int | None, ObjectPath]]:
        # the listing includes the sizes, so no request is needed for the size of a path
        for path in (self.root / EPISODES).walk():
            index = index_of_file(path.name)
            yield index if index is not None and path == self._file_of(index) else None, path

    def _store_shard(self, part: Path, name: str) -> None:
        final = self.root / EPISODES / name
        try:
            self._put_new(final.key, part)
        except FileExistsError:  # an earlier put, whose response was lost, created the object, or the object is damaged
            if digest_of(final) != digest_of(part):
                self._objects.put(final.key, part.read_bytes())

    def _delete(self, places: Collection[Place]) -> None:
        self._objects.delete(*(f"{EPISODES}/{place.name}" for place in places))

    def _set_aside(self, path: Place, reason: str) -> Place:
        """Moves an object to the quarantine folder of the dataset, a local file to the quarantine folder of the state
        directory. Writes the reason to a file beside it, and returns the new path."""
        if isinstance(path, Path):
            folder = self._state_dir / QUARANTINE
            with translated("open", folder):
                folder.mkdir(exist_ok=True)
            return set_aside(path, folder, reason)
        place = self._explained(path, reason)
        self._objects.copy(path.key, place.key)
        self._objects.delete(path.key)
        return place

    def _keep_copy(self, path: PackedPath, reason: str) -> ObjectPath:
        place = self._explained(path, reason)
        self._objects.put_new(place.key, path.read_bytes(checked=False))
        return place

    def _explained(self, path: ObjectPath | PackedPath, reason: str) -> ObjectPath:
        """Writes the reason to the quarantine folder. Returns an unused path there, for the copy that the
        caller makes."""
        place = self.root / QUARANTINE / f"{path.name}.{secrets.token_hex(4)}"
        self._objects.put(f"{place.key}.reason.txt", f"{path}\n{reason}\n".encode())
        log.warning("quarantined", file=str(path), moved_to=str(place), reason=reason)
        return place

    def restore(self, path: Place, index: int) -> ObjectPath:
        assert isinstance(path, ObjectPath), path
        final = self._file_of(index)
        self._require_free(index)
        self._objects.copy(path.key, final.key)
        self._objects.delete(path.key)
        self._objects.delete(f"{path.key}.reason.txt")
        return final

    def free_bytes(self) -> int:
        """See `Archive.free_bytes`. Returns the free space of the state directory; object storage has no limit."""
        return self._staging.free_bytes()

    def _keep(self, source: Path, place: Place) -> None:
        assert isinstance(place, ObjectPath), place
        with contextlib.suppress(FileExistsError):  # an earlier put, whose response was lost, created the object
            self._put_new(place.key, source)

    def _drop(self, place: Place) -> None:
        assert isinstance(place, ObjectPath), place
        self._objects.delete(place.key)

    @contextlib.contextmanager
    def replacing(self, name: str) -> Iterator[Path]:
        part = self._staging.part(name.rpartition("/")[2])
        try:
            with translated("write", part):
                yield part
                data = part.read_bytes()
            self._objects.put(name, data)
        finally:
            part.unlink(missing_ok=True)

    def _put_new(self, key: str, file: Path) -> None:
        with translated("read", file):
            opened = file.open("rb")
        with opened:
            if os.fstat(opened.fileno()).st_size == 0:
                self._objects.put_new(key, b"")
                return
            # maps the file instead of reading it; the mapping ends when the last upload releases it
            self._objects.put_new(key, mmap.mmap(opened.fileno(), 0, access=mmap.ACCESS_READ))

    def _lock(self) -> None:
        mine = json.dumps({"home": self._id, "host": socket.gethostname(), "directory": str(self._state_dir)}).encode()
        try:
            self._objects.put_new(_LOCK, mine)
        except FileExistsError as error:
            holder = _holder(self.root)
            if holder.get("home") != self._id:  # otherwise an earlier process with this state directory left the lock
                raise WorldError(
                    f"{self.root} is in use by another coordinator, that of {holder.get('directory')} on host "
                    f"{holder.get('host')}; stop it first, or choose another --out. If it will not run again: "
                    f"`factory repair --take-over {quoted(self.root)}`"
                ) from error
        try:
            self._objects.put_new(_LOCK, mine)
        except FileExistsError:
            return
        self._objects.delete(_LOCK)
        raise WorldError(
            f"{self.root}: the object store ignores conditional writes (If-None-Match), so two "
            "coordinators could overwrite each other's files: use a store that supports conditional writes"
        )

    def close(self) -> None:
        """Releases the dataset, so a coordinator with another state directory can open it."""
        try:
            if _holder(self.root).get("home") == self._id:
                self._objects.delete(_LOCK)
        except WorldError as error:
            log.warning(
                "lock_left_behind",
                dataset=str(self.root),
                error=str(error),
                remedy="open the dataset with the same state directory",
            )
        finally:
            self._staging.close()


def other_holder(root: ObjectPath, state_dir: Path) -> str:
    """Returns the path and host of another state directory that has locked a dataset; empty if there is none."""
    holder, name = _holder(root), state_dir / _NAME
    if not holder or (name.exists() and holder.get("home") == name.read_text(encoding="ascii")):
        return ""
    return f"{holder.get('directory')} on host {holder.get('host')}"


def _holder(root: ObjectPath) -> dict[str, str]:
    try:
        holder = json.loads(root.objects.read(_LOCK))
    except (FileNotFoundError, ValueError):
        return {}
    return holder if isinstance(holder, dict) else {}


def _id_of(state_dir: Path) -> str:
    """Returns the random id of a state directory, and creates it if necessary. The caller holds its lock."""
    file = state_dir / _NAME
    with translated("write", file):
        if not file.exists():
            part = file.with_name(f"{_NAME}.part")
            part.write_text(secrets.token_hex(16), encoding="ascii")
            part.replace(file)
        return file.read_text(encoding="ascii")
