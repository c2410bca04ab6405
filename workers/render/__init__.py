"""Protocol of the renderers, and the types of their frames: colour, depth, instance ids and normals.

Does not render and imports no graphics library.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import NamedTuple, Protocol, cast, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from schemas.config import CameraConfig
from schemas.encoding.image_sizes import FRAME_SIZE_PX
from schemas.frame import Frame
from schemas.rig import Camera
from schemas.scene import CompiledScene
from workers.geometry.pose import Pose

__all__ = [
    "WHOLE",
    "CameraImage",
    "DepthAndIds",
    "Frame",
    "PartialRenderer",
    "RenderedAtlas",
    "Renderer",
    "Window",
    "as_partial",
]


class Window(NamedTuple):
    """Rectangle of an image, pixels; empty if it has no rows or no columns."""

    top: int
    left: int
    bottom: int
    """First row below the rectangle."""
    right: int
    """First column to the right of the rectangle."""

    @property
    def is_empty(self) -> bool:
        """Whether the window has no pixels."""
        return self.top >= self.bottom or self.left >= self.right

    @property
    def pixels(self) -> int:
        """Number of pixels."""
        return max(0, self.bottom - self.top) * max(0, self.right - self.left)


WHOLE = Window(0, 0, FRAME_SIZE_PX, FRAME_SIZE_PX)
"""Window of a whole frame."""


@dataclass(frozen=True)
class DepthAndIds:
    """Image without colour; its arrays equal those of a frame, bit for bit."""

    depth: NDArray[np.float32]
    """Depth, as `Frame.depth`."""
    ids: NDArray[np.uint16]
    """Instance ids, as `Frame.ids`."""

    def cut(self, window: Window) -> DepthAndIds:
        """Returns the part of a frame in a window."""
        rows, columns = slice(window.top, window.bottom), slice(window.left, window.right)
        return DepthAndIds(self.depth[rows, columns], self.ids[rows, columns])


@dataclass(frozen=True)
class RenderedAtlas:
    """Faces of a camera in one image (`workers.geometry.faces`); rows from the top."""

    rgb: NDArray[np.uint8]
    """(height, width, 3) sRGB, or with a fourth channel, which is undefined, if the atlas is resampled."""
    depth: NDArray[np.float32]
    """(height, width) metres along the optical axis of each face; 0 where no surface is within the clip range."""
    ids: NDArray[np.uint16]
    """(height, width) instance ids; 0 for no surface."""
    normals: NDArray[np.uint8] | None = None
    """(height, width, 3) encoded normals, see `shaders.NORMALS`; undefined where no surface was hit."""


@dataclass(frozen=True)
class CameraImage:
    """Image of a camera of a rig; rows from the top, arrays not shared with the renderer."""

    rgb: NDArray[np.uint8]
    """(height, width, 3) sRGB, top row first; black outside of the image circle of a fisheye camera."""
    depth: NDArray[np.float32]
    """(height, width) depth in metres by the measure of the camera, axial or radial; 0 where no surface was hit."""
    ids: NDArray[np.uint16]
    """(height, width) instance id of the nearest surface; 0 for no surface."""
    normals: NDArray[np.float32] | None = None
    """(height, width, 3) unit normals towards the camera, in its optical frame; 0 where no surface was hit. `None`
    unless the camera has the output `normals`."""


class Renderer(AbstractContextManager["Renderer", None], Protocol):
    """Renderer of compiled scenes from the robot's camera; it is opened once and closed once."""

    @property
    def description(self) -> str:
        """Description of the renderer with driver and version; every episode records it."""

    def load(self, scene: CompiledScene, camera: CameraConfig) -> None:
        """Selects the scene and the camera. Recently used scenes stay prepared, so their next use is fast."""

    def load_by_key(self, key: Hashable, read: Callable[[], CompiledScene], camera: CameraConfig) -> None:
        """Does what `load` does, but takes a key and a function that reads the scene.

        Args:
            key: key of the scene; equal keys are the same scene.
            read: returns the scene; called if it is not prepared.
            camera: camera of the robot.
        """

    def make_room(self) -> None:
        """Frees the prepared scenes that the next new scene will replace, before it is read, to reduce peak memory.

        If this frees the selected scene, `load` must select one before the next frame.
        """

    def render(self, pose: Pose, size: int | None = None) -> Frame:
        """Returns the camera image for a pose of base_link.

        Args:
            pose: pose of base_link in the world.
            size: width and height of the frame, pixels; `None` is the default size of the renderer. The field of view
                does not depend on the size.

        Raises:
            UsageError: no scene was loaded.
        """

    def render_depth_and_ids(self, pose: Pose) -> DepthAndIds:
        """Returns depth and ids of the frame that `render` returns; takes half the time with OpenGL.

        Raises:
            UsageError: no scene was loaded.
        """

    def render_camera(self, camera: Camera, pose: Pose) -> CameraImage:
        """Returns the image of a camera of a rig, without noise, for a pose of base_link.

        Args:
            camera: any camera; it need not be the loaded one.
            pose: pose of base_link in the world.

        Raises:
            UsageError: no scene was loaded, or this renderer has no normals, which the camera needs.
        """

    def close(self) -> None:
        """Frees all resources; further calls have no effect."""


@runtime_checkable
class PartialRenderer(Protocol):
    """Renderer that renders one instance at a lower cost than the whole image, with the same pixels."""

    def render_instance(self, pose: Pose, instance_id: int) -> tuple[Window, DepthAndIds]:
        """Returns a window of the image from a pose with all pixels of an instance, and the image in that window.

        In the window, surfaces that are behind the instance may be missing.

        Raises:
            UsageError: no scene was loaded.
        """

    def count_within(self, pose: Pose, window: Window, depth_m: float) -> int:
        """Returns the number of pixels in a window of the image with a depth above 0 and below `depth_m`.

        Raises:
            UsageError: no scene was loaded.
        """


def as_partial(renderer: Renderer) -> PartialRenderer | None:
    """Returns the renderer if it can render parts of the image, else `None`.

    Looks for one method, because `isinstance` with a protocol takes 20 us.
    """
    return cast(PartialRenderer, renderer) if hasattr(renderer, "render_instance") else None
