"""Caller's side of the rendering process: starts and ends the process, sends requests, and detects when it dies.

Does not manage scenes; the renderer does.
"""

from __future__ import annotations

import contextlib
import os
import weakref

from schemas.config import CameraConfig
from schemas.errors import UsageError, WorldError
from schemas.support.child import python_module
from schemas.support.child_process import ChildProcess, Ended
from schemas.terms import RendererKind
from workers.geometry.pose import Pose
from workers.process.one_core import one_core
from workers.render.prepared_scenes import KEPT_SCENES
from workers.render.process_wire import FrameMemory, RenderRequest, Reply, ReplyKind, RequestKind, to_line

_ANSWER_S = 300.0
_LEAVE_S = 3.0
_CAMERA, _ORIGIN = CameraConfig(), Pose(0.0, 0.0, 0.0)
_CHILD = python_module("workers.render.process_child")


class RenderingProcess:
    """Handle of a rendering process, which serves one request at a time and ends with this handle or this process."""

    description: str
    """Description of the renderer in the process."""

    def __init__(self, kind: RendererKind, size: int, kept_scenes: int) -> None:
        self._pid, self._number = os.getpid(), 0
        self._process = ChildProcess(
            Reply.model_validate_json, start_s=_ANSWER_S, silence_s=_ANSWER_S, leave_s=_LEAVE_S, stderr="inherit"
        )
        self._scene = os.fdopen(os.memfd_create("minivla-scene"), "wb")
        memory = FrameMemory.create()
        self.frames = FrameMemory(memory)
        with os.fdopen(memory), contextlib.ExitStack() as held:
            for each in (self._scene, self.frames, self._process):
                held.callback(each.close)
            _start(self._process, kind, size, kept_scenes, (memory, self._scene.fileno()))
            self._end = weakref.finalize(self, held.pop_all().close)
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
        self._process.send(to_line(request))
        self._receive(self._number)

    def close(self) -> None:
        """Ends the process; further calls have no effect."""
        self._end()

    def release_in_fork(self) -> None:
        """Releases the handle in a fork of the owner, without ending the process."""
        self._end.detach()
        self._process.release_in_fork()
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
            reply = self._process.wait()
            if isinstance(reply, Ended):
                self.close()
                raise WorldError(f"the rendering process {_how_it_ended(reply)}")
            if reply.number == number:
                break
        if reply.kind is ReplyKind.USAGE:
            raise UsageError(reply.detail)
        if reply.kind is ReplyKind.WORLD:
            raise WorldError(reply.detail)
        if reply.kind is ReplyKind.DEFECT:
            raise RuntimeError(f"the rendering process failed: {reply.detail}")
        return reply.detail


_running: weakref.WeakSet[RenderingProcess] = weakref.WeakSet()


def _release_all_in_fork() -> None:
    for process in list(_running):
        process.release_in_fork()


os.register_at_fork(after_in_child=_release_all_in_fork)


def _start(
    process: ChildProcess[Reply], kind: RendererKind, size: int, kept_scenes: int, memories: tuple[int, int]
) -> None:
    """Starts the process with the descriptors of its frame memory and scene memory."""
    frames, scenes = memories
    options = {"--renderer": kind, "--size": size, "--kept-scenes": kept_scenes, "--frames": frames, "--scenes": scenes}
    command = (*_CHILD, *(str(word) for option in options.items() for word in option))
    try:
        process.start(command, _environment(kept_scenes), memories)
    except OSError as error:
        raise WorldError(f"cannot start the rendering process `{' '.join(command)}`: {error}") from error


def _environment(kept_scenes: int) -> dict[str, str]:
    """Returns the environment for rendering on one core, or with the number of threads that the user set for Mesa.

    With more than the default number of scenes, the process is expected to prepare many scenes in turn.
    """
    chosen = {name: os.environ[name] for name in ("LP_NUM_THREADS",) if name in os.environ}
    return {**one_core(os.environ, many_scenes=kept_scenes > KEPT_SCENES), **chosen}


def _how_it_ended(end: Ended) -> str:
    if end.is_hung:
        return f"did not answer within {_ANSWER_S:g} s; it was ended"
    if not end.is_reaped:
        return "died: it closed the connection and cannot be killed"
    return f"died: {end.description}; its messages are on stderr"
