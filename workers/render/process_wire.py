"""What a renderer and its rendering process exchange: requests and replies as JSON lines, frames in shared memory.

Starts no process and draws nothing.
"""

from __future__ import annotations

import mmap
import os
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from schemas.base import Model
from schemas.config import CameraConfig
from workers.geometry.pose import Pose
from workers.render import DepthAndIds, RenderedFrame

__all__ = ["MAX_SIZE_PX", "FrameMemory", "RenderRequest", "Reply", "ReplyKind", "RequestKind", "to_line"]

MAX_SIZE_PX = 2048
"""Largest width and height of a frame, pixels."""
_PIXELS = MAX_SIZE_PX * MAX_SIZE_PX
_DEPTH_AT, _IDS_AT, _RGB_AT = 0, 4 * _PIXELS, 6 * _PIXELS
_BYTES = 9 * _PIXELS


class RequestKind(StrEnum):
    """What the rendering process is asked to do."""

    STORE = "store"  # read a scene from the scene memory and keep it
    DROP = "drop"  # forget a scene
    LOAD = "load"  # show a stored scene with a camera
    RENDER = "render"  # draw colour, depth and ids
    RELIEF = "relief"  # draw depth and ids


class RenderRequest(Model):
    """One request; each gets one reply."""

    number: int
    kind: RequestKind
    scene: int = 0
    """Number of the scene to store, drop or load."""
    camera: CameraConfig = CameraConfig()
    """The camera to load the scene with."""
    pose: Pose = Pose(0.0, 0.0, 0.0)
    """Pose of base_link in the world, to draw from."""
    size: int = 0
    """Width and height of the frame, pixels."""


class ReplyKind(StrEnum):
    """What came of a request."""

    DONE = "done"  # what was asked for
    USAGE = "usage"  # a `UsageError`
    WORLD = "world"  # any other `FactoryError`
    DEFECT = "defect"  # any other exception


class Reply(Model):
    """The reply to one request, or, with number 0, the renderer's description."""

    number: int
    kind: ReplyKind = ReplyKind.DONE
    detail: str = ""
    """The description, or the message of an error."""


def to_line(message: RenderRequest | Reply) -> bytes:
    """Returns the message as one line."""
    return message.model_dump_json(exclude_defaults=True).encode() + b"\n"


class FrameMemory:
    """One frame of up to `MAX_SIZE_PX` in shared memory; pages that no frame has used take no memory."""

    def __init__(self, descriptor: int) -> None:
        """Maps the memory.

        Args:
            descriptor: of a memory file; `create` makes one.
        """
        self._memory = mmap.mmap(descriptor, _BYTES)

    @staticmethod
    def create() -> int:
        """Returns the descriptor of new, empty memory; the caller closes it."""
        descriptor = os.memfd_create("minivla-frames")
        os.ftruncate(descriptor, _BYTES)
        return descriptor

    def put(self, seen: RenderedFrame | DepthAndIds) -> None:
        """Stores a frame, or depth and ids of one."""
        size = len(seen.depth)
        self._depth(size)[:] = seen.depth
        self._ids(size)[:] = seen.ids
        if isinstance(seen, RenderedFrame):
            self._rgb(size)[:] = seen.rgb

    def take_frame(self, size: int) -> RenderedFrame:
        """Returns a copy of the frame of that size that was stored last."""
        return RenderedFrame(self._rgb(size).copy(), self._depth(size).copy(), self._ids(size).copy())

    def take_relief(self, size: int) -> DepthAndIds:
        """Returns a copy of its depth and ids."""
        return DepthAndIds(self._depth(size).copy(), self._ids(size).copy())

    def close(self) -> None:
        """Unmaps the memory; closing twice is harmless."""
        self._memory.close()

    def _rgb(self, size: int) -> NDArray[np.uint8]:
        return np.frombuffer(self._memory, np.uint8, 3 * size * size, _RGB_AT).reshape(size, size, 3)

    def _depth(self, size: int) -> NDArray[np.float32]:
        return np.frombuffer(self._memory, np.float32, size * size, _DEPTH_AT).reshape(size, size)

    def _ids(self, size: int) -> NDArray[np.uint16]:
        return np.frombuffer(self._memory, np.uint16, size * size, _IDS_AT).reshape(size, size)
