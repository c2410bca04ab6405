"""Protocol of the renderers of the front camera, and the types of their frames: colour, depth and instance ids.

Does not render and imports no graphics library.
"""

from __future__ import annotations

from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from schemas.config import CameraConfig
from schemas.scene import CompiledScene
from workers.geometry.pose import Pose

__all__ = ["DepthAndIds", "RenderedFrame", "Renderer"]


@dataclass(frozen=True)
class RenderedFrame:
    """Image of the camera; rows from the top, arrays not shared with the renderer."""

    rgb: NDArray[np.uint8]
    """(size, size, 3) sRGB; where no surface is visible, the sky of the scene, or black without one."""
    depth: NDArray[np.float32]
    """(size, size) metres along the optical axis; 0 where no surface is within the clip range."""
    ids: NDArray[np.uint16]
    """(size, size) instance id of the nearest surface; 0 for no surface."""


@dataclass(frozen=True)
class DepthAndIds:
    """Image without colour; its arrays equal those of a frame, bit for bit."""

    depth: NDArray[np.float32]
    """Depth, as `RenderedFrame.depth`."""
    ids: NDArray[np.uint16]
    """Instance ids, as `RenderedFrame.ids`."""


class Renderer(AbstractContextManager["Renderer", None], Protocol):
    """Renderer of compiled scenes from the robot's camera; it is opened once and closed once."""

    @property
    def description(self) -> str:
        """Description of the renderer with driver and version; every episode records it."""

    def load(self, scene: CompiledScene, camera: CameraConfig) -> None:
        """Selects the scene and the camera. Recently used scenes stay prepared, so that their next use is fast."""

    def render(self, pose: Pose, size: int | None = None) -> RenderedFrame:
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

    def close(self) -> None:
        """Frees all resources; further calls have no effect."""
