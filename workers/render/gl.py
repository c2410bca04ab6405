"""OpenGL renderer: renders colour, depth and ids in one pass, on EGL without a display.

Does not simulate, encode images or read the environment. The calling process sets `LP_NUM_THREADS=0` for llvmpipe
before it opens the renderer.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Hashable
from typing import Any, NamedTuple

import moderngl
import numpy as np
from numpy.typing import NDArray

from schemas.config import CameraConfig
from schemas.encoding.arrays import FRAME_SIZE_PX
from schemas.errors import UsageError, WorldError
from schemas.scene import CompiledScene
from schemas.support.closing import Closing
from schemas.support.portable import product
from schemas.support.stage_timer import StageTimer, no_stage_timer
from workers.geometry.camera import OpticalPose, optical_pose, projection_matrix, view_matrix
from workers.geometry.pose import Pose
from workers.render import DepthAndIds, RenderedFrame, Window
from workers.render.cull import edges_of
from workers.render.gl_scene import DrawOrder, GpuScene, Programs
from workers.render.gl_target import GlTarget, onto_target
from workers.render.shelf import KEPT_SCENES, SceneShelf
from workers.render.sky import SkyPainter

_EGL: dict[str, Any] = {"backend": "egl", "libegl": "libEGL.so.1", "libgl": "libEGL.so.1"}
"""Libraries of the context. libEGL provides all functions of OpenGL, so that the user need not install libGL."""
_AFTER_FORK = "start that process with the multiprocessing context 'spawn' or 'forkserver'"
"""Remedy for a forked process, which has the driver's memory without its threads: rendering would wait forever."""
_used_by: set[int] = set()
"""Id of the process that opened a context; a forked process has another id."""


class _View(NamedTuple):
    """View of a scene from one pose."""

    optical: OpticalPose
    clip: NDArray[np.float64]
    """(4, 4) matrix from world to OpenGL clip space, for column vectors."""
    matrix: bytes
    """Matrix of the shader programs."""
    drawn: DrawOrder


class GlRenderer(Closing):
    """`Renderer` with a separate OpenGL 4.5 context; every call makes that context current."""

    def __init__(
        self, size: int = FRAME_SIZE_PX, lap: StageTimer = no_stage_timer, kept_scenes: int = KEPT_SCENES
    ) -> None:
        """Opens the context and its targets.

        Args:
            size: width and height of the frames, pixels.
            lap: called at the end of the stages `render` and `read-back` of every frame.
            kept_scenes: number of scenes that stay on the device.

        Raises:
            UsageError: OpenGL was used before this process was forked.
            WorldError: this machine has no usable EGL driver.
        """
        self._camera = CameraConfig()
        self._projection = projection_matrix(self._camera)
        self._lap = lap
        self._size = size
        self._context = _open_context()
        self._pid = os.getpid()
        self._is_open = True
        self.description = _describe(self._context)
        self._shelf = SceneShelf(self._prepare, kept_scenes)
        self._scene: GpuScene | None = None
        self._sky = SkyPainter(None, self._camera)
        with self._context:
            self._programs = Programs(self._context)
            self._targets = {size: GlTarget(self._context, size)}
            self._context.enable_only(moderngl.DEPTH_TEST | moderngl.CULL_FACE)
            self._context.front_face = "cw"  # because `onto_target` mirrors the image

    def close(self) -> None:
        """Frees the context and its resources; further calls have no effect."""
        if self._is_open:
            self._is_open = False
            self._scene = None
            if self._pid != os.getpid():
                return  # the context belongs to the process that this one was forked from
            with self._context:
                self._shelf.clear()
            self._context.release()

    def load(self, scene: CompiledScene, camera: CameraConfig) -> None:
        """Selects the scene and the camera; the most recently used scenes stay on the device."""
        self.load_by_key(id(scene), lambda: scene, camera)  # the function holds the scene, so that its id stays unique

    def load_by_key(self, key: Hashable, read: Callable[[], CompiledScene], camera: CameraConfig) -> None:
        """Selects a scene by a key and the camera; see `Renderer`."""
        self._require_own_process()
        self._camera = camera
        self._projection = projection_matrix(camera)
        with self._context:
            self._scene = self._shelf.take(key, read)
        self._sky = SkyPainter(self._scene.sky, camera)

    def render(self, pose: Pose, size: int | None = None) -> RenderedFrame:
        """Returns the camera image for a pose of base_link.

        Args:
            pose: pose of base_link in the world.
            size: width and height of the frame, pixels; `None` is the default size of the renderer.

        Raises:
            UsageError: no scene was loaded, or this process was forked after the renderer was opened.
        """
        scene = self._loaded()
        view = self._look(scene, pose)
        with self._context:
            target = self._target(size or self._size)
            target.begin()
            scene.draw(view.drawn, view.matrix)
            self._context.finish()  # reading would wait as long; this separates rendering from copying in profiles
            self._lap("render")
            rgb = target.read_colour()
            relief = target.read_relief(self._camera, rgb)
        self._sky.paint(rgb, relief.depth, view.optical)
        self._lap("read-back")
        return RenderedFrame(rgb, relief.depth, relief.ids)

    def render_depth_and_ids(self, pose: Pose) -> DepthAndIds:
        """Returns depth and ids without rendering colour, bit-identical to those of `render`.

        Raises:
            UsageError: no scene was loaded.
        """
        scene = self._loaded()
        view = self._look(scene, pose)
        return self._render_bare(scene, view.matrix, view.drawn.parts)

    def render_instance(self, pose: Pose, instance_id: int) -> tuple[Window, DepthAndIds]:
        """Returns a window that contains all pixels of an instance, and that part of the image.

        Draws what is in the window and not behind the instance.

        Raises:
            UsageError: no scene was loaded.
        """
        scene = self._loaded()
        view = self._look(scene, pose)
        window, depth_m = scene.window_of(view.drawn, instance_id, view.clip, self._camera, self._size)
        if window.is_empty:
            return window, DepthAndIds(np.empty((0, 0), np.float32), np.empty((0, 0), np.uint16))
        parts = scene.parts_before(view.drawn, view.optical, edges_of(window, self._size, self._camera), depth_m)
        return window, self._render_bare(scene, view.matrix, parts, window)

    def count_within(self, pose: Pose, window: Window, depth_m: float) -> int:
        """Returns the number of pixels in a window of the image with a depth above 0 and below `depth_m`.

        Draws what may be so near, usually nothing.

        Raises:
            UsageError: no scene was loaded.
        """
        scene, optical = self._loaded(), optical_pose(pose, self._camera)
        parts = scene.parts_within(optical, edges_of(window, self._size, self._camera), depth_m)
        if not len(parts):
            return 0
        depth = self._render_bare(scene, self._matrix(optical)[1], parts, window).depth
        return int(np.count_nonzero(depth < depth_m)) - int(np.count_nonzero(depth == 0.0))

    def _render_bare(
        self, scene: GpuScene, matrix: bytes, parts: NDArray[np.intp], window: Window | None = None
    ) -> DepthAndIds:
        with self._context:
            target = self._target(self._size)
            target.begin(window)
            scene.draw_bare(parts, matrix)
            self._context.finish()
            self._lap("render")
            relief = target.read_relief(self._camera, window=window)
        self._lap("read-back")
        return relief

    def _target(self, size: int) -> GlTarget:
        """Returns the target of a size; targets are kept for reuse."""
        if size not in self._targets:
            self._targets[size] = GlTarget(self._context, size)
        return self._targets[size]

    def _require_own_process(self) -> None:
        if self._pid != os.getpid():
            raise UsageError(f"this renderer was opened by process {self._pid} before a fork; {_AFTER_FORK}")

    def _loaded(self) -> GpuScene:
        self._require_own_process()
        if self._scene is None:
            raise UsageError("no scene is loaded: call load(scene, camera) before render(pose)")
        return self._scene

    def _look(self, scene: GpuScene, pose: Pose) -> _View:
        optical = optical_pose(pose, self._camera)
        clip, matrix = self._matrix(optical)
        return _View(optical, clip, matrix, scene.order(clip, optical, self._camera))

    def _matrix(self, optical: OpticalPose) -> tuple[NDArray[np.float64], bytes]:
        """Returns the matrix from world to OpenGL clip space, and that of the shader programs."""
        clip = product(self._projection, view_matrix(optical))
        return clip, onto_target(clip, self._camera).T.astype(np.float32).tobytes()

    def _prepare(self, scene: CompiledScene) -> GpuScene:
        return GpuScene(self._context, self._programs, scene)


def _open_context() -> moderngl.Context:
    if _used_by and os.getpid() not in _used_by:
        raise UsageError(f"OpenGL was used before a fork of this process and would hang; {_AFTER_FORK}")
    try:
        context = moderngl.create_context(require=450, standalone=True, **_EGL)
    except Exception as error:  # glcontext raises nothing more specific
        raise WorldError(f"OpenGL 4.5 with EGL is not available on this machine: {error}") from error
    _used_by.add(os.getpid())
    return context


def _describe(context: moderngl.Context) -> str:
    return f"{context.info['GL_RENDERER']}; OpenGL {context.info['GL_VERSION']}"
