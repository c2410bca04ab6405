"""Renderers: what the front camera sees as colour, depth and instance ids, behind one protocol.

Says what a renderer and a frame are; it never draws and imports no graphics library.
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
    """One look of the camera; rows from the top, arrays freshly owned by the frame."""

    rgb: NDArray[np.uint8]
    """(size, size, 3) sRGB; black where nothing was hit."""
    depth: NDArray[np.float32]
    """(size, size) metres along the optical axis; 0 where nothing was hit within the clip range."""
    ids: NDArray[np.uint16]
    """(size, size) instance id of the nearest surface; 0 is nothing."""


@dataclass(frozen=True)
class DepthAndIds:
    """A look without its colour; what it has is a frame's, bit for bit."""

    depth: NDArray[np.float32]
    """As `Frame.depth`."""
    ids: NDArray[np.uint16]
    """As `Frame.ids`."""


class Renderer(AbstractContextManager["Renderer", None], Protocol):
    """Something that can show a compiled scene from the robot's camera; opened once, closed once."""

    @property
    def description(self) -> str:
        """The renderer in its own words, driver and version included; recorded with every episode."""

    def load(self, scene: CompiledScene, camera: CameraConfig) -> None:
        """Makes `scene` the one that `camera` shows. Scenes shown lately stay ready, so that going back is cheap."""

    def render(self, pose: Pose, size: int | None = None) -> RenderedFrame:
        """Returns what the camera sees when base_link stands at `pose` in the world.

        Args:
            pose: of base_link in the world.
            size: width and height of the frame, pixels; `None` is the size that the renderer was opened with. The
                field of view does not depend on it.

        Raises:
            UsageError: no scene was loaded.
        """

    def render_depth_and_ids(self, pose: Pose) -> DepthAndIds:
        """Returns depth and ids of what `render` returns; on OpenGL at half the cost.

        Raises:
            UsageError: no scene was loaded.
        """

    def close(self) -> None:
        """Frees everything; closing twice is harmless."""
