"""Applies the camera change of an episode, a mounting pose and a focal length, to a renderer. Draws no frame itself."""

from __future__ import annotations

from collections.abc import Callable, Hashable

from schemas.appearance import CameraChange
from schemas.config import CameraConfig
from schemas.rig import Camera
from schemas.scene import CompiledScene
from schemas.support.closing import Closing
from workers.appearance.cameras import changed_camera, recorded_camera
from workers.geometry.pose import Pose
from workers.render import CameraImage, DepthAndIds, RenderedFrame, Renderer


class ShiftedRenderer(Closing):
    """`Renderer` that changes each camera and passes it to another renderer, which the caller opens and closes.

    Args:
        renderer: renderer with the scene loaded.
        camera: recorded camera.
        change: change of the cameras.
        size: width and height of the frames, pixels.
    """

    def __init__(self, renderer: Renderer, camera: CameraConfig, change: CameraChange, size: int) -> None:
        self._renderer, self._camera, self._change, self._size = renderer, camera, change, size

    @property
    def description(self) -> str:
        """Description of the renderer."""
        return self._renderer.description

    def load(self, scene: CompiledScene, camera: CameraConfig) -> None:
        """Selects the scene and the recorded camera."""
        self._camera = camera
        self._renderer.load(scene, camera)

    def load_by_key(self, key: Hashable, read: Callable[[], CompiledScene], camera: CameraConfig) -> None:
        """Selects a scene by a key, and the recorded camera."""
        self._camera = camera
        self._renderer.load_by_key(key, read, camera)

    def make_room(self) -> None:
        """Frees prepared scenes of the other renderer; see `Renderer`."""
        self._renderer.make_room()

    def render(self, pose: Pose, size: int | None = None) -> RenderedFrame:
        """Returns the image of the recorded camera with its change."""
        image = self.render_camera(recorded_camera(self._camera, size or self._size), pose)
        return RenderedFrame(image.rgb, image.depth, image.ids)

    def render_depth_and_ids(self, pose: Pose) -> DepthAndIds:
        """Returns depth and ids of the frame that `render` returns."""
        frame = self.render(pose)
        return DepthAndIds(frame.depth, frame.ids)

    def render_camera(self, camera: Camera, pose: Pose) -> CameraImage:
        """Returns the image of a camera with its change; raises `UsageError` if its lens does not permit it."""
        return self._renderer.render_camera(changed_camera(camera, self._change), pose)

    def close(self) -> None:
        """Does nothing: the caller closes the other renderer."""
