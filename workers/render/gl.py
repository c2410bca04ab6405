"""The OpenGL renderer: colour, depth and ids in one pass, on EGL without a screen.

It never touches physics, encodes images or reads the environment: `LP_NUM_THREADS=0`, wanted for llvmpipe, is set by
the process that opens it, before it is opened.
"""

from __future__ import annotations

from types import TracebackType
from typing import Any, Self

import moderngl
import numpy as np
from numpy.typing import NDArray

from schemas.arrays import FRAME_SIZE_PX
from schemas.config import CameraConfig
from schemas.errors import UsageError, WorldError
from schemas.lap import Lap, no_lap
from schemas.scene import CompiledScene
from workers.camera import optical_pose, projection_matrix, view_matrix
from workers.pose import Pose
from workers.render import Frame, Relief
from workers.render.gl_scene import GpuScene, Lens, Programs
from workers.render.shelf import SceneShelf

__all__ = ["GlRenderer"]

_KEPT_SCENES = 2
_EGL: dict[str, Any] = {"backend": "egl", "libegl": "libEGL.so.1", "libgl": "libEGL.so.1"}
"""libEGL hands out every function of OpenGL by itself; asking for no libGL spares the user a package."""
_ALL_TARGETS: Any = ((True,) * 4,) * 3
_DEPTH_ONLY: Any = ((False,) * 4, (True,) * 4, (False,) * 4)
"""Masks of colour, depth and ids; moderngl's types know only that of one target."""
_GUARD = 3
"""The viewport is so many times as wide as the target, which is its middle: llvmpipe draws what has a corner beyond the
viewport at a third of the speed, and what is beyond the target at no cost."""
_ONTO_TARGET = np.diag((1.0 / _GUARD, -1.0 / _GUARD, 1.0, 1.0))
"""Into the middle of the viewport, and mirrored, so that an image's top row comes first in memory, where OpenGL has the
bottom row."""


class GlRenderer:
    """A `Renderer` on an OpenGL 4.3 context of its own; every call makes that context current."""

    def __init__(self, size: int = FRAME_SIZE_PX, lap: Lap = no_lap) -> None:
        """Opens the context and its targets.

        Args:
            size: width and height of the frames, pixels.
            lap: told the end of the stages `render` and `read-back` of every frame.

        Raises:
            WorldError: this machine has no usable EGL driver.
        """
        self._camera = CameraConfig()
        self._projection = projection_matrix(self._camera)
        self._size = size
        self._lap = lap
        self._context = _open_context()
        self._is_open = True
        self.description = _describe(self._context)
        self._shelf = SceneShelf(self._prepare, _KEPT_SCENES)
        self._scene: GpuScene | None = None
        with self._context:
            self._programs = Programs(self._context)
            shape = (size, size)
            self._rgb = self._context.texture(shape, 3)
            self._depth = self._context.texture(shape, 1, dtype="f4")
            self._ids = self._context.texture(shape, 1, dtype="u2")
            self._target = self._context.framebuffer(
                (self._rgb, self._depth, self._ids), self._context.depth_renderbuffer(shape)
            )
            beside = size * (_GUARD // 2)
            self._target.viewport = (-beside, -beside, size * _GUARD, size * _GUARD)
            self._context.enable_only(moderngl.DEPTH_TEST | moderngl.CULL_FACE)
            self._context.front_face = "cw"  # because `_ONTO_TARGET` mirrors the image

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Frees the context and all in it; closing twice is harmless."""
        if self._is_open:
            self._is_open = False
            with self._context:
                self._shelf.clear()
            self._scene = None
            self._context.release()

    def load(self, scene: CompiledScene, camera: CameraConfig) -> None:
        """Makes `scene` the one that `camera` shows; the last few scenes stay on the device."""
        self._camera = camera
        self._projection = projection_matrix(camera)
        with self._context:
            self._scene = self._shelf.take(scene)

    def render(self, pose: Pose) -> Frame:
        """Returns what the camera sees when base_link stands at `pose` in the world.

        Raises:
            UsageError: no scene was loaded.
        """
        scene = self._loaded()
        lens, parts = self._look(scene, pose)
        with self._context:
            self._begin()
            scene.draw(parts, lens)
            self._context.finish()  # reading would wait just as long; so the wait is told apart from the copy
            self._lap("render")
            rgb = np.empty((self._size, self._size, 3), np.uint8)
            self._target.read_into(rgb, components=3, attachment=0)
            relief = self._read_relief(rgb)
        self._lap("read-back")
        return Frame(rgb, relief.depth, relief.ids)

    def render_relief(self, pose: Pose) -> Relief:
        """Returns depth and ids without drawing colour; the same parts in the same order give the same bits.

        Raises:
            UsageError: no scene was loaded.
        """
        scene = self._loaded()
        lens, parts = self._look(scene, pose)
        with self._context:
            self._begin()
            scene.draw_bare(parts, lens)
            self._context.finish()
            self._lap("render")
            relief = self._read_relief()
        self._lap("read-back")
        return relief

    def _loaded(self) -> GpuScene:
        if self._scene is None:
            raise UsageError("nothing to render: call load(scene, camera) before render(pose)")
        return self._scene

    def _look(self, scene: GpuScene, pose: Pose) -> tuple[Lens, NDArray[np.intp]]:
        """Returns what the programs need to know of a pose, and the parts to be drawn from it."""
        optical = optical_pose(pose, self._camera)
        clip = self._projection @ view_matrix(optical)
        lens = Lens((_ONTO_TARGET @ clip).T.astype(np.float32).tobytes(), self._camera.far_m)
        return lens, scene.parts_to_draw(clip, optical, self._camera)

    def _begin(self) -> None:
        """Takes the targets and clears what tells where nothing is: colour and ids are blanked there after reading."""
        self._target.use()
        self._target.color_mask = _DEPTH_ONLY
        self._target.clear()
        self._target.color_mask = _ALL_TARGETS

    def _read_relief(self, *beside: NDArray[np.uint8]) -> Relief:
        """Reads depth and ids; blanks the ids, and what was read beside them, where nothing is."""
        shape = (self._size, self._size)
        depth, ids = np.empty(shape, np.float32), np.empty(shape, np.uint16)
        self._target.read_into(depth, components=1, attachment=1, dtype="f4")
        self._target.read_into(ids, components=1, attachment=2, dtype="u2")
        if not depth.min():
            void = np.flatnonzero(depth == 0)
            images: tuple[NDArray[Any], ...] = (ids, *beside)
            for image in images:
                image.reshape(self._size * self._size, -1)[void] = 0
        return Relief(depth, ids)

    def _prepare(self, scene: CompiledScene) -> GpuScene:
        return GpuScene(self._context, self._programs, scene)


def _open_context() -> moderngl.Context:
    try:
        return moderngl.create_context(require=430, standalone=True, **_EGL)
    except Exception as error:  # glcontext raises nothing more specific
        raise WorldError(f"no OpenGL 4.3 through EGL on this machine: {error}") from error


def _describe(context: moderngl.Context) -> str:
    return f"{context.info['GL_RENDERER']}; OpenGL {context.info['GL_VERSION']}"
