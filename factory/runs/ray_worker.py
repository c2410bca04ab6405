"""Supervisor of the worker of one Ray node: an actor that starts `factory worker`, which ends with the actor.

Does not import Ray: the driver turns the class into an actor.
"""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import os
import shutil
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Never

from schemas.errors import WorldError
from schemas.protocol.identity import CA_FILE, NAME_FILE
from schemas.support.child import child_environment, python_module
from schemas.support.child_process import ChildProcess
from schemas.support.closing import Closing
from schemas.terms import RendererKind

PREFIX = "minivla-ray-"
"""Beginning of the names of all folders of this engine."""
_LOCK = ".lock"
_ATTEMPTS, _PAUSE_S = 50, 0.2
_OLD_S = 31 * 86_400.0
"""Age from which a folder without a lock is removed, seconds: its certificates have expired."""
_LEAVE_S = 8.0
"""Maximum time that a stopped worker has to return its jobs, seconds."""


# one actor for each node, because a Ray task for each job would load the scene again each time
class RayWorker:
    """Worker process of one node, which uses the cores that Ray has assigned to the actor.

    The process stops when its standard input is closed, even if the actor is killed.

    Args:
        endpoint: Endpoint of the coordinator.
        files: Content of the TLS folder of the node by file name.
        cores: Number of simulation processes.
        renderer: Renderer of the simulations.
    """

    def __init__(self, endpoint: str, files: Mapping[str, bytes], cores: int, renderer: RendererKind) -> None:
        name = _name_of(files)
        self._keys, self._spool = Scratch(name, memory_folder()), Scratch(f"{name}-spool", Path(tempfile.gettempdir()))
        self._process: ChildProcess[Never] = ChildProcess(None, leave_s=_LEAVE_S, stderr="inherit")
        for name, data in files.items():
            path = self._keys.path / name
            path.touch(mode=0o600)
            path.write_bytes(data)
        self._command = [
            *python_module("factory", "worker", "--until-eof", "--cores", str(cores), "--renderer", renderer),
            *("--connect", endpoint, "--tls", str(self._keys.path), "--spool", str(self._spool.path)),
        ]

    def run(self) -> int:
        """Runs the worker until it exits, and returns its exit status."""
        self._process.start(self._command, child_environment(os.environ))
        return self._process.wait().status

    def stop(self) -> None:
        """Ends the worker, which returns its jobs, and removes its files; may be called while `run` runs."""
        self._process.kill()
        self._keys.close()
        self._spool.close()


class Scratch(Closing):
    """Private folder of this process, which is removed when it is closed, or by a later start on the same machine.

    The process has a lock in the folder; the lock of a killed process is free, so the next `Scratch` in `base`
    removes its folder. A restarted process of the same name takes over the folder with its content.

    Args:
        name: name of the folder, which begins with `PREFIX`.
        base: folder that contains it.

    Raises:
        WorldError: the folder belongs to another user, or another process uses it.
    """

    def __init__(self, name: str, base: Path) -> None:
        self.path = base / name
        """The folder."""
        remove_stale(base, keep=name)
        for _ in range(_ATTEMPTS):
            self.path.mkdir(mode=0o700, exist_ok=True)
            if self.path.is_symlink() or self.path.stat().st_uid != os.getuid():
                raise WorldError(f"{self.path} belongs to another user: remove it on this node")
            lock = _lock_of(self.path)
            # another start may have removed the folder before it was locked
            if lock is not None and _is_at(lock, self.path / _LOCK):
                self._lock = lock
                return
            if lock is not None:
                os.close(lock)
            time.sleep(_PAUSE_S)
        raise WorldError(f"{self.path} is in use by another process of this node: end it, or remove the folder")

    def close(self) -> None:
        """Removes the folder."""
        if self._lock >= 0:
            shutil.rmtree(self.path, ignore_errors=True)
            os.close(self._lock)
            self._lock = -1


def remove_stale(base: Path, keep: str = "") -> list[Path]:
    """Removes the folders of killed processes of this user: their locks are free. Returns the removed folders.

    Args:
        base: folder that contains them.
        keep: name of a folder that is not removed.
    """
    removed = []
    for folder in base.glob(f"{PREFIX}*"):
        with contextlib.suppress(OSError):
            if folder.name == keep or folder.is_symlink() or folder.stat().st_uid != os.getuid():
                continue
            # a folder without a lock is one of an older version, which may be in use while its certificates are valid
            if not (folder / _LOCK).exists() and time.time() - folder.stat().st_mtime < _OLD_S:
                continue
            lock = _lock_of(folder)
            if lock is not None:
                shutil.rmtree(folder, ignore_errors=True)
                os.close(lock)
                removed.append(folder)
    return removed


def memory_folder() -> Path:
    """Returns a folder in memory for keys, which no reboot leaves behind; the temporary folder if there is none."""
    memory = Path("/dev/shm")  # noqa: S108 - the folders in it are private
    return memory if memory.is_dir() and os.access(memory, os.W_OK | os.X_OK) else Path(tempfile.gettempdir())


def _lock_of(folder: Path) -> int | None:
    """Returns the locked descriptor of the lock file of a folder; `None` if another process holds the lock."""
    try:
        lock = os.open(folder / _LOCK, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o600)
    except FileNotFoundError:
        return None  # the folder was removed meanwhile
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(lock)
        return None
    return lock


def _is_at(descriptor: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(descriptor), path.stat())
    except FileNotFoundError:
        return False


def _name_of(files: Mapping[str, bytes]) -> str:
    """Returns the name of the folders of a worker. It depends on node and run only, so a restarted actor finds the
    bundles in the spool."""
    run = hashlib.sha256(files[CA_FILE]).hexdigest()[:12]
    return f"minivla-{files[NAME_FILE].decode().strip()}-{run}"
