"""Messages between a renderer and its rendering process: requests and replies as JSON lines, frames in shared memory.

Starts no process and renders nothing.
"""

from __future__ import annotations

import mmap
import os
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from schemas.base import Model
from schemas.config import CameraConfig
from schemas.encoding.image_sizes import MAX_SIZE_PX
from schemas.frame import Frame
from schemas.rig.cameras import MAX_PIXELS
from workers.geometry.pose import Pose
from workers.render import CameraImage, DepthAndIds

_PIXELS = max(MAX_SIZE_PX * MAX_SIZE_PX, MAX_PIXELS)
_DEPTH_AT, _NORMALS_AT, _IDS_AT, _RGB_AT = 0, 4 * _PIXELS, 16 * _PIXELS, 18 * _PIXELS
_BYTES = 21 * _PIXELS


class RequestKind(StrEnum):
    """Type of a request to the rendering process."""

    STORE = "store"  # reads a scene from the scene memory and stores it
    DROP = "drop"  # deletes a stored scene
    LOAD = "load"  # selects a stored scene and a camera
    RENDER = "render"  # renders colour, depth and ids
    DEPTH_AND_IDS = "depth_and_ids"  # renders depth and ids
    CAMERA = "camera"  # renders a camera of a rig


class RenderRequest(Model):
    """Request to the rendering process; each gets one reply."""

    number: int
    """Number of the request, from 1."""
    kind: RequestKind
    """Type of the request."""
    scene: int = 0
    """Number of the scene to store, drop or load."""
    camera: CameraConfig = CameraConfig()
    """Camera to load the scene with."""
    pose: Pose = Pose(0.0, 0.0, 0.0)
    """Pose of base_link in the world to render from."""
    size: int = 0
    """Width and height of the frame, pixels."""
    sensor: str = ""
    """Camera of a rig, as JSON text: the process parses each text once."""


class ReplyKind(StrEnum):
    """Result of a request."""

    DONE = "done"  # success
    USAGE = "usage"  # a `UsageError`
    WORLD = "world"  # any other `FactoryError`
    DEFECT = "defect"  # any other exception


class Reply(Model):
    """Reply to one request, or, with number 0, the description of the renderer."""

    number: int
    """Number of the request; 0 for the first reply."""
    kind: ReplyKind = ReplyKind.DONE
    """Result of the request."""
    detail: str = ""
    """Description of the renderer, or error message."""


def to_line(message: RenderRequest | Reply) -> bytes:
    """Returns the message as one JSON line."""
    return message.model_dump_json(exclude_defaults=True).encode() + b"\n"


class FrameMemory:
    """Shared memory for one frame or camera image of at most `MAX_PIXELS`; unused pages take no memory."""

    def __init__(self, descriptor: int) -> None:
        """Maps the memory.

        Args:
            descriptor: file descriptor of a memory file; `create` returns one.
        """
        self._memory = mmap.mmap(descriptor, _BYTES)

    @staticmethod
    def create() -> int:
        """Returns the descriptor of new, empty memory; the caller closes it."""
        descriptor = os.memfd_create("minivla-frames")
        os.ftruncate(descriptor, _BYTES)
        return descriptor

    def put(self, seen: Frame | DepthAndIds | CameraImage) -> None:
        """Stores a frame or a camera image, or depth and ids only."""
        height, width = seen.depth.shape
        self._depth(height, width)[:] = seen.depth
        self._ids(height, width)[:] = seen.ids
        if not isinstance(seen, DepthAndIds):
            self._rgb(height, width)[:] = seen.rgb
        if isinstance(seen, CameraImage) and seen.normals is not None:
            self._normals(height, width)[:] = seen.normals

    def take_frame(self, size: int) -> Frame:
        """Returns a copy of the stored frame; `size` is its size."""
        return Frame(self._rgb(size, size).copy(), self._depth(size, size).copy(), self._ids(size, size).copy())

    def take_depth_and_ids(self, size: int) -> DepthAndIds:
        """Returns a copy of depth and ids of the stored frame; `size` is its size."""
        return DepthAndIds(self._depth(size, size).copy(), self._ids(size, size).copy())

    def take_image(self, height: int, width: int, normals: bool) -> CameraImage:
        """Returns a copy of the stored camera image; the arguments are its size and whether it has normals."""
        size = height, width
        rgb, depth, ids = self._rgb(*size).copy(), self._depth(*size).copy(), self._ids(*size).copy()
        return CameraImage(rgb, depth, ids, self._normals(*size).copy() if normals else None)

    def close(self) -> None:
        """Unmaps the memory; further calls have no effect."""
        self._memory.close()

    def _rgb(self, height: int, width: int) -> NDArray[np.uint8]:
        return np.frombuffer(self._memory, np.uint8, 3 * height * width, _RGB_AT).reshape(height, width, 3)

    def _depth(self, height: int, width: int) -> NDArray[np.float32]:
        return np.frombuffer(self._memory, np.float32, height * width, _DEPTH_AT).reshape(height, width)

    def _ids(self, height: int, width: int) -> NDArray[np.uint16]:
        return np.frombuffer(self._memory, np.uint16, height * width, _IDS_AT).reshape(height, width)

    def _normals(self, height: int, width: int) -> NDArray[np.float32]:
        return np.frombuffer(self._memory, np.float32, 3 * height * width, _NORMALS_AT).reshape(height, width, 3)
