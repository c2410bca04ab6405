"""Caller's side of the rendering process: starts and ends the process, sends requests, and detects when it dies.

Does not manage scenes; the renderer does.
"""

from __future__ import annotations

import contextlib
import os
import socket
import subprocess
import weakref

from schemas.config import CameraConfig
from schemas.errors import UsageError, WorldError
from schemas.support.child import python_module
from schemas.support.jsonl_process import describe_exit
from schemas.terms import RendererKind
from workers.geometry.pose import Pose
from workers.process.one_core import one_core
from workers.render.prepared_scenes import KEPT_SCENES
from workers.render.process_wire import FrameMemory, RenderRequest, Reply, ReplyKind, RequestKind, to_line

_ANSWER_S = 300.0
_REAP_S = 3.0
_CAMERA, _ORIGIN = CameraConfig(), Pose(0.0, 0.0, 0.0)
_CHILD = python_module("workers.render.process_child")


class RenderingProcess:
    """Handle of a rendering process, which serves one request at a time and ends with this handle or this process."""

    description: str
    """Description of the renderer in the process."""

    def __init__(self, kind: RendererKind, size: int, kept_scenes: int) -> None:
        self._pid, self._number, self._unread = os.getpid(), 0, b""
        self._scene = os.fdopen(os.memfd_create("minivla-scene"), "wb")
        self._socket, theirs = socket.socketpair()
        self._socket.settimeout(_ANSWER_S)
        memory = FrameMemory.create()
        self.frames = FrameMemory(memory)
        with theirs, os.fdopen(memory), contextlib.ExitStack() as held:
            for each in (self._socket, self._scene, self.frames):
                held.callback(each.close)
            self._process = _start(kind, size, kept_scenes, theirs, memory, self._scene.fileno())
            self._end = weakref.finalize(self, _end, self._process, held.pop_all())
        _running.add(self)
        try:
            self.description = self._receive(0)
        except BaseException:
            self.close()
            raise

    @property
    def is_open(self) -> bool:
        """Whether the process serves requests: it was not closed and is not known to be dead."""
        return self._end.alive

    def send_scene(self, package: bytes) -> None:
        """Replaces the content of the scene memory."""
        self._require_open()
        self._scene.seek(0)
        self._scene.truncate()
        self._scene.write(package)
        self._scene.flush()

    def ask(
        self,
        kind: RequestKind,
        *,
        scene: int = 0,
        camera: CameraConfig = _CAMERA,
        pose: Pose = _ORIGIN,
        size: int = 0,
        sensor: str = "",
    ) -> None:
        """Sends a request and waits for its reply.

        Raises:
            UsageError: the request is not valid, the process was closed, or this process is a fork of its owner.
            WorldError: the renderer failed, or the process died or did not answer.
        """
        self._require_open()
        self._number += 1
        request = RenderRequest(
            number=self._number, kind=kind, scene=scene, camera=camera, pose=pose, size=size, sensor=sensor
        )
        with contextlib.suppress(ConnectionError):  # reading the reply detects the death of the process
            self._socket.sendall(to_line(request))
        self._receive(self._number)

    def close(self) -> None:
        """Ends the process; further calls have no effect."""
        self._end()

    def release_in_fork(self) -> None:
        """Releases the handle in a fork of the owner, without ending the process."""
        self._end.detach()
        self._process.returncode = 0  # the process is not a child of the fork, so the fork cannot wait for it
        self._socket.close()
        self._scene.close()

    def _require_open(self) -> None:
        if self._pid != os.getpid():
            raise UsageError(
                f"this renderer was opened by process {self._pid} before a fork: open it in the process that "
                "uses it (Gymnasium: create the environment there, as `make_vec(..., vectorization_mode='async')` does)"
            )
        if not self.is_open:
            raise UsageError("this renderer is closed: open another one")

    def _receive(self, number: int) -> str:
        """Returns the detail of the reply to a request; ignores replies to interrupted requests."""
        while True:
            reply = Reply.model_validate_json(self._read_line())
            if reply.number == number:
                break
        if reply.kind is ReplyKind.USAGE:
            raise UsageError(reply.detail)
        if reply.kind is ReplyKind.WORLD:
            raise WorldError(reply.detail)
        if reply.kind is ReplyKind.DEFECT:
            raise RuntimeError(f"the rendering process failed: {reply.detail}")
        return reply.detail

    def _read_line(self) -> bytes:
        while b"\n" not in self._unread:
            try:
                received = self._socket.recv(1 << 16)
            except TimeoutError as error:
                self.close()
                raise WorldError(
                    f"the rendering process did not answer within {_ANSWER_S:g} s; it was ended"
                ) from error
            except ConnectionError:
                received = b""
            if not received:
                raise WorldError(f"the rendering process died: {self._how_it_ended()}")
            self._unread += received
        line, _, self._unread = self._unread.partition(b"\n")
        return line

    def _how_it_ended(self) -> str:
        self.close()
        status = self._process.poll()
        if status is None:
            return "it closed the connection and cannot be killed"
        return f"{describe_exit(status)}; its messages are on stderr"


_running: weakref.WeakSet[RenderingProcess] = weakref.WeakSet()


def _release_all_in_fork() -> None:
    for process in list(_running):
        process.release_in_fork()


os.register_at_fork(after_in_child=_release_all_in_fork)


def _start(
    kind: RendererKind, size: int, kept_scenes: int, theirs: socket.socket, frames: int, scenes: int
) -> subprocess.Popen[bytes]:
    options = {"--renderer": kind, "--size": size, "--kept-scenes": kept_scenes, "--frames": frames, "--scenes": scenes}
    command = (*_CHILD, *(str(word) for option in options.items() for word in option))
    try:
        return subprocess.Popen(
            command,
            stdin=theirs.fileno(),
            stdout=theirs.fileno(),
            pass_fds=(frames, scenes),
            env=_environment(kept_scenes),
            start_new_session=True,  # Ctrl-C reaches the caller only, which closes the renderer
        )
    except OSError as error:
        raise WorldError(f"cannot start the rendering process `{' '.join(command)}`: {error}") from error


def _environment(kept_scenes: int) -> dict[str, str]:
    """Returns the environment for rendering on one core, or with the number of threads that the user set for Mesa.

    With more than the default number of scenes, the process is expected to prepare many scenes in turn.
    """
    chosen = {name: os.environ[name] for name in ("LP_NUM_THREADS",) if name in os.environ}
    return {**one_core(os.environ, many_scenes=kept_scenes > KEPT_SCENES), **chosen}


def _end(process: subprocess.Popen[bytes], held: contextlib.ExitStack) -> None:
    """Closes the connection, so the process exits; kills a process that does not exit."""
    held.close()
    try:
        process.wait(_REAP_S)
    except subprocess.TimeoutExpired:
        process.kill()
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(_REAP_S)
