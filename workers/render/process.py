"""Renderer in a separate process, for programs that run code of the user in the process of the simulation.

Mesa loads its driver, and with it LLVM, with RTLD_GLOBAL. A library with another LLVM that is loaded into the same
process later, such as triton, is bound to Mesa's LLVM and crashes. The driver's threads do not survive a fork either.
A process that has not loaded the driver has neither problem. This module loads no graphics library.

Design: docs/design/rendering.md#rendering-in-another-process.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable

from schemas.config import CameraConfig
from schemas.encoding.image_sizes import FRAME_SIZE_PX, MAX_SIZE_PX
from schemas.errors import UsageError
from schemas.frame import Frame
from schemas.rig import Camera, CameraOutput
from schemas.scene import CompiledScene, encode_scene
from schemas.support.closing import Closing
from schemas.support.stage_timer import StageTimer, no_stage_timer
from schemas.terms import RendererKind
from workers.geometry.pose import Pose
from workers.render import CameraImage, DepthAndIds
from workers.render.prepared_scenes import KEPT_SCENES, PreparedSceneCache
from workers.render.process_link import RenderingProcess
from workers.render.process_wire import RequestKind


class ProcessRenderer(Closing):
    """`Renderer` in a separate process; its frames equal those of an in-process renderer, bit for bit."""

    def __init__(
        self,
        kind: RendererKind = "auto",
        size: int = FRAME_SIZE_PX,
        timer: StageTimer = no_stage_timer,
        kept_scenes: int = KEPT_SCENES,
    ) -> None:
        """Starts the process and waits until its renderer is open.

        Args:
            kind: type of the renderer.
            size: width and height of the frames, pixels.
            timer: called at the end of the stages `render` and `read-back` of every frame.
            kept_scenes: number of scenes that stay prepared.

        Raises:
            UsageError: the size is not in 1..`MAX_SIZE_PX`.
            WorldError: the process cannot be started, or the machine has no such renderer.
        """
        self._size, self._timer = _checked(size), timer
        self._process = RenderingProcess(kind, size, kept_scenes)
        self._shelf = PreparedSceneCache(_Storage(self._process).store, kept_scenes)
        self.description = self._process.description

    def close(self) -> None:
        """Ends the process; further calls have no effect."""
        self._process.close()

    @property
    def is_open(self) -> bool:
        """Whether the process can render: it was not closed and has not died."""
        return self._process.is_open

    def load(self, scene: CompiledScene, camera: CameraConfig) -> None:
        """Selects the scene and the camera; recently used scenes stay prepared."""
        # the cache keeps the lambda and thus the scene, so no other scene gets its id
        self.load_by_key(id(scene), lambda: scene, camera)

    def load_by_key(self, key: Hashable, read: Callable[[], CompiledScene], camera: CameraConfig) -> None:
        self.load_package(key, lambda: encode_scene(read(), level=1), camera)

    def load_package(self, key: Hashable, read: Callable[[], bytes], camera: CameraConfig) -> None:
        """Selects a scene by its package, which this process does not decode; recently used scenes stay prepared.

        Args:
            key: key of the scene, such as the SHA-256 of its package.
            read: returns the package; called if the scene is not prepared.
            camera: camera of the robot.
        """
        self._process.ask(RequestKind.LOAD, scene=self._shelf.take(key, read).number, camera=camera)

    def make_room(self) -> None:
        """Frees the stored packages that the next new scene will replace; see `Renderer`."""
        self._shelf.make_room()

    @property
    def prepared(self) -> tuple[Hashable, ...]:
        """Keys of the prepared scenes, the most recently used one last."""
        return self._shelf.keys

    def render(self, pose: Pose, size: int | None = None) -> Frame:
        """Returns the camera image for a pose of base_link.

        Args:
            pose: pose of base_link in the world.
            size: width and height of the frame, pixels; `None` is the default size of the renderer.

        Raises:
            UsageError: no scene was loaded, or this process was forked after the renderer was opened.
            WorldError: the rendering process died.
        """
        size = _checked(size or self._size)
        self._process.ask(RequestKind.RENDER, pose=pose, size=size)
        self._timer("render")
        frame = self._process.frames.take_frame(size)
        self._timer("read-back")
        return frame

    def render_depth_and_ids(self, pose: Pose) -> DepthAndIds:
        """Returns depth and ids of the frame that `render` returns; raises the same errors."""
        self._process.ask(RequestKind.DEPTH_AND_IDS, pose=pose)
        self._timer("render")
        depth_and_ids = self._process.frames.take_depth_and_ids(self._size)
        self._timer("read-back")
        return depth_and_ids

    def render_camera(self, camera: Camera, pose: Pose) -> CameraImage:
        """Returns the image of a camera of a rig for a pose of base_link; raises the errors of `render`."""
        self._process.ask(RequestKind.CAMERA, pose=pose, sensor=camera.model_dump_json(exclude_defaults=True))
        self._timer("render")
        image = self._process.frames.take_image(camera.height, camera.width, CameraOutput.NORMALS in camera.outputs)
        self._timer("read-back")
        return image


def _checked(size: int) -> int:
    if not 1 <= size <= MAX_SIZE_PX:
        raise UsageError(f"frame size {size} is not valid: choose 1 to {MAX_SIZE_PX} pixels")
    return size


class _Storage:
    """Sends scenes to the process, each with a unique number."""

    def __init__(self, process: RenderingProcess) -> None:
        self._process, self._count = process, 0

    def store(self, package: bytes) -> _Stored:
        self._count += 1
        self._process.send_scene(package)
        self._process.ask(RequestKind.STORE, scene=self._count)
        return _Stored(self._process, self._count)


class _Stored:
    """Scene that the process stores."""

    def __init__(self, process: RenderingProcess, number: int) -> None:
        self._process, self.number = process, number

    def close(self) -> None:
        """Deletes the scene in the process."""
        self._process.ask(RequestKind.DROP, scene=self.number)
