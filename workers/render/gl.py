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
from schemas.encoding.image_sizes import FRAME_SIZE_PX
from schemas.errors import UsageError, WorldError
from schemas.frame import Frame
from schemas.rig import Camera
from schemas.scene import CompiledScene
from schemas.support.closing import Closing
from schemas.support.portable import product
from schemas.support.stage_timer import StageTimer, no_stage_timer
from workers.geometry.camera import OpticalPose, Perspective, optical_pose, view_matrix
from workers.geometry.faces import Face, FacePlan
from workers.geometry.pose import Pose
from workers.render import CameraImage, DepthAndIds, RenderedAtlas, Window
from workers.render.compose import compose_image
from workers.render.gl_scene import DrawOrder, GpuScene, Programs
from workers.render.gl_target import GlTarget, onto_target
from workers.render.gl_textures import TextureStore
from workers.render.prepared_scenes import KEPT_SCENES, PreparedSceneCache
from workers.render.sky import SkyPainter
from workers.render.visible_parts import edges_of

_KEPT_TARGETS = 16
_EGL: dict[str, Any] = {"backend": "egl", "libegl": "libEGL.so.1", "libgl": "libEGL.so.1"}
"""Libraries of the context. libEGL provides all functions of OpenGL, so the user need not install libGL."""
_AFTER_FORK = "start that process with the multiprocessing context 'spawn' or 'forkserver'"
"""Remedy for a forked process, which has the driver's memory without its threads: rendering would wait forever."""
_used_by: set[int] = set()
"""Id of the process that opened a context; a forked process has a different id."""


class _View(NamedTuple):
    """View of a scene from one pose."""

    optical: OpticalPose
    clip: NDArray[np.float64]
    """(4, 4) matrix from world to OpenGL clip space, for column vectors."""
    matrix: bytes
    """Matrix that the shader programs use, float32 bytes by columns: `clip`, converted for a `GlTarget`."""
    drawn: DrawOrder


class GlRenderer(Closing):
    """`Renderer` with a separate OpenGL 4.5 context; every call makes that context current."""

    def __init__(
        self, size: int = FRAME_SIZE_PX, timer: StageTimer = no_stage_timer, kept_scenes: int = KEPT_SCENES
    ) -> None:
        """Opens the context and its targets.

        Args:
            size: width and height of the frames, pixels.
            timer: called at the end of the stages `render` and `read-back` of every frame.
            kept_scenes: number of scenes that stay on the device.

        Raises:
            UsageError: OpenGL was used before this process was forked.
            WorldError: this machine has no usable EGL driver.
        """
        self._camera = CameraConfig()
        self._timer = timer
        self._size = size
        self._context = _open_context()
        self._pid = os.getpid()
        self._is_open = True
        self.description = _describe(self._context)
        self._shelf = PreparedSceneCache(self._prepare, kept_scenes)
        self._scene: GpuScene | None = None
        self._sky = SkyPainter(None)
        with self._context:
            self._programs = Programs(self._context)
            self._textures = TextureStore(self._context)
            self._targets = {(size, size): GlTarget(self._context, size, size)}
            self._context.enable_only(moderngl.DEPTH_TEST | moderngl.CULL_FACE)
            self._context.front_face = "cw"  # clockwise, because `onto_target` mirrors the image

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
        # the cache keeps the lambda and thus the scene, so no other scene gets its id
        self.load_by_key(id(scene), lambda: scene, camera)

    def load_by_key(self, key: Hashable, read: Callable[[], CompiledScene], camera: CameraConfig) -> None:
        self._require_own_process()
        self._camera = camera
        with self._context:
            self._scene = self._shelf.take(key, read)
        self._sky = SkyPainter(self._scene.sky)

    def make_room(self) -> None:
        """Frees prepared scenes in advance, so the next scene fits; see `Renderer`."""
        self._require_own_process()
        with self._context:
            self._shelf.make_room()
        if not self._shelf.keys:  # without prepared scenes, the selected scene was freed, too
            self._scene = None

    def render(self, pose: Pose, size: int | None = None) -> Frame:
        """Returns the camera image for a pose of base_link.

        Args:
            pose: pose of base_link in the world.
            size: width and height of the frame, pixels; `None` is the default size of the renderer.

        Raises:
            UsageError: no scene was loaded, or this process was forked after the renderer was opened.
        """
        # each call has a size, because a second renderer for small images would upload every scene again
        scene, image = self._loaded(), self._image(size)
        view = _look(scene, image, optical_pose(pose, self._camera))
        with self._context:
            target = self._target(image.width, image.height)
            target.begin()
            scene.draw(view.drawn, view.matrix)
            self._context.finish()  # separates the times of rendering and copying; reading would wait anyway
            self._timer("render")
            rgb = target.read_colour()
            depth_and_ids = target.read_depth_and_ids(image, rgb)
        self._sky.paint(rgb, depth_and_ids.depth, view.optical, image)
        self._timer("read-back")
        return Frame(rgb, depth_and_ids.depth, depth_and_ids.ids)

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

        Draws only the parts that are in the window and not behind the instance.

        Raises:
            UsageError: no scene was loaded.
        """
        scene = self._loaded()
        view = self._look(scene, pose)
        window, depth_m = scene.window_of(view.drawn, instance_id, clip=view.clip, camera=self._camera, size=self._size)
        if window.is_empty:
            return window, DepthAndIds(np.empty((0, 0), np.float32), np.empty((0, 0), np.uint16))
        parts = scene.parts_before(view.drawn, view.optical, edges_of(window, self._size, self._camera), depth_m)
        return window, self._render_bare(scene, view.matrix, parts, window)

    def count_within(self, pose: Pose, window: Window, depth_m: float) -> int:
        """Returns the number of pixels in a window of the image with a depth above 0 and below `depth_m`.

        Draws only the parts that may be closer than `depth_m`; usually there are none.

        Raises:
            UsageError: no scene was loaded.
        """
        scene, optical = self._loaded(), optical_pose(pose, self._camera)
        parts = scene.parts_within(optical, edges_of(window, self._size, self._camera), depth_m)
        if not len(parts):
            return 0
        depth = self._render_bare(scene, _matrix(self._image(), optical)[1], parts, window).depth
        return int(np.count_nonzero(depth < depth_m)) - int(np.count_nonzero(depth == 0.0))

    def _render_bare(
        self, scene: GpuScene, matrix: bytes, parts: NDArray[np.intp], window: Window | None = None
    ) -> DepthAndIds:
        with self._context:
            target = self._target(self._size, self._size)
            target.begin(window)
            scene.draw_bare(parts, matrix)
            self._context.finish()
            self._timer("render")
            depth_and_ids = target.read_depth_and_ids(self._image(), window=window)
        self._timer("read-back")
        return depth_and_ids

    def render_faces(self, plan: FacePlan, optical: OpticalPose, normals: bool = False) -> RenderedAtlas:
        """Returns the atlas of the faces of a camera.

        Args:
            plan: faces of the camera.
            optical: pose of the optical frame of the camera.
            normals: whether normals are rendered too, which takes another pass.

        Raises:
            UsageError: no scene was loaded, or this process was forked after the renderer was opened.
        """
        scene = self._loaded()
        looks = [(face, face.optical(optical)) for face in plan.faces]
        views = [(face, _look(scene, face.view, eye)) for face, eye in looks]
        clip_range = plan.faces[0].view
        with self._context:
            target = self._target(plan.width, plan.height)
            target.begin()
            for face, view in views:
                target.begin_face(face)
                scene.draw(view.drawn, view.matrix)
            self._context.finish()
            self._timer("render")
            rgb = target.read_colour(channels=3 if plan.sampling is None else 4)
            depth_and_ids = target.read_depth_and_ids(clip_range, rgb)
            codes = self._render_normals(scene, target, views) if normals else None
        for face, eye in looks:
            part = np.s_[face.top : face.top + face.view.height, : face.view.width]
            self._sky.paint(rgb[part], depth_and_ids.depth[part], eye, face.view)
        self._timer("read-back")
        return RenderedAtlas(rgb, depth_and_ids.depth, depth_and_ids.ids, codes)

    def render_camera(self, camera: Camera, pose: Pose) -> CameraImage:
        """Returns the image of a camera of a rig for a pose of base_link; raises the errors of `render_faces`."""
        return compose_image(self, camera, pose)

    def _render_normals(self, scene: GpuScene, target: GlTarget, views: list[tuple[Face, _View]]) -> NDArray[np.uint8]:
        target.begin()
        for face, view in views:
            target.begin_face(face)
            scene.draw_normals(view.drawn.parts, view.matrix, view.optical.eye)
        return target.read_colour()

    def _image(self, size: int | None = None) -> Perspective:
        return Perspective.of(self._camera, size or self._size)

    def _target(self, width: int, height: int) -> GlTarget:
        """Returns the target of a size; the most recently used targets are kept for reuse."""
        size = width, height
        target = self._targets.pop(size, None) or GlTarget(self._context, width, height)
        self._targets[size] = target
        if len(self._targets) > _KEPT_TARGETS:
            self._targets.pop(next(iter(self._targets))).release()
        return target

    def _require_own_process(self) -> None:
        if self._pid != os.getpid():
            raise UsageError(f"this renderer was opened by process {self._pid} before a fork; {_AFTER_FORK}")

    def _loaded(self) -> GpuScene:
        self._require_own_process()
        if self._scene is None:
            raise UsageError("no scene is loaded: call load(scene, camera) before render(pose)")
        return self._scene

    def _look(self, scene: GpuScene, pose: Pose) -> _View:
        return _look(scene, self._image(), optical_pose(pose, self._camera))

    def _prepare(self, scene: CompiledScene) -> GpuScene:
        return GpuScene(self._context, self._programs, self._textures, scene)


def _look(scene: GpuScene, image: Perspective, optical: OpticalPose) -> _View:
    clip, matrix = _matrix(image, optical)
    return _View(optical, clip, matrix, scene.order(clip, optical, image))


def _matrix(image: Perspective, optical: OpticalPose) -> tuple[NDArray[np.float64], bytes]:
    """Returns the matrix from world to OpenGL clip space, and the bytes of the shader programs' matrix."""
    clip = product(image.matrix(), view_matrix(optical))
    return clip, onto_target(clip, image.near_m).T.astype(np.float32).tobytes()


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
