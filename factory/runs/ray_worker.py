"""Supervisor of the worker of one Ray node: an actor that starts `factory worker`, which ends with the actor.

Does not import Ray: the driver turns the class into an actor.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Never

from schemas.errors import WorldError
from schemas.protocol.identity import CA_FILE, NAME_FILE
from schemas.support.child import child_environment, python_module
from schemas.support.child_process import ChildProcess
from schemas.terms import RendererKind

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
        self._folder = _folder_of(files)
        self._process: ChildProcess[Never] = ChildProcess(None, leave_s=_LEAVE_S, stderr="inherit")
        for name, data in files.items():
            path = self._folder / name
            path.touch(mode=0o600)
            path.write_bytes(data)
        self._command = [
            *python_module("factory", "worker", "--until-eof", "--cores", str(cores), "--renderer", renderer),
            *("--connect", endpoint, "--tls", str(self._folder), "--spool", str(self._folder / "spool")),
        ]

    def run(self) -> int:
        """Runs the worker until it exits, and returns its exit status."""
        self._process.start(self._command, child_environment(os.environ))
        return self._process.wait().status

    def stop(self) -> None:
        """Ends the worker, which returns its jobs, and removes its files; may be called while `run` runs."""
        self._process.kill()
        shutil.rmtree(self._folder, ignore_errors=True)


def _folder_of(files: Mapping[str, bytes]) -> Path:
    """Creates and returns the folder of a worker. The path depends on node and run only, so a restarted actor finds the
    bundles in the spool."""
    run = hashlib.sha256(files[CA_FILE]).hexdigest()[:12]
    folder = Path(tempfile.gettempdir()) / f"minivla-{files[NAME_FILE].decode().strip()}-{run}"
    folder.mkdir(mode=0o700, exist_ok=True)
    if folder.is_symlink() or folder.stat().st_uid != os.getuid():
        raise WorldError(f"{folder} belongs to another user: remove it on this node")
    return folder
