"""Draws a change of the cameras, a mounting pose and a focal length, and applies it to a rig or a renderer.

Draws no frame.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable

from pydantic import ValidationError

from schemas.appearance import CameraChange, CameraRanges
from schemas.config import CameraConfig
from schemas.errors import UsageError
from schemas.frame import Frame
from schemas.rig import Camera, FisheyeCamera, Lidar2d, Lidar3d, Mount, PinholeCamera
from schemas.scene import CompiledScene
from schemas.support.closing import Closing
from workers.appearance.factor_stream import FactorStream
from workers.geometry.pose import Pose
from workers.render import CameraImage, DepthAndIds, Renderer


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
        return self._renderer.description

    def load(self, scene: CompiledScene, camera: CameraConfig) -> None:
        self._camera = camera
        self._renderer.load(scene, camera)

    def load_by_key(self, key: Hashable, read: Callable[[], CompiledScene], camera: CameraConfig) -> None:
        self._camera = camera
        self._renderer.load_by_key(key, read, camera)

    def make_room(self) -> None:
        """Frees prepared scenes of the other renderer; see `Renderer`."""
        self._renderer.make_room()

    def render(self, pose: Pose, size: int | None = None) -> Frame:
        """Returns the image of the recorded camera with its change."""
        image = self.render_camera(recorded_camera(self._camera, size or self._size), pose)
        return Frame(image.rgb, image.depth, image.ids)

    def render_depth_and_ids(self, pose: Pose) -> DepthAndIds:
        frame = self.render(pose)
        return DepthAndIds(frame.depth, frame.ids)

    def render_camera(self, camera: Camera, pose: Pose) -> CameraImage:
        """Returns the image of a camera with its change; raises `UsageError` if its lens does not permit it."""
        return self._renderer.render_camera(changed_camera(camera, self._change), pose)

    def close(self) -> None:
        """Does nothing: the caller closes the other renderer."""


Scan = Lidar2d | Lidar3d
_LEAST_HEIGHT_M = 0.02


def draw_camera(ranges: CameraRanges, stream: FactorStream) -> CameraChange:
    names = ("x_m", "y_m", "z_m", "roll_deg", "pitch_deg", "yaw_deg", "focal", "exposure_stops")
    return CameraChange.model_validate({name: stream.between(getattr(ranges, name)) for name in names})


def recorded_camera(config: CameraConfig, size: int) -> PinholeCamera:
    """Returns the recorded camera as a camera of a rig, with images of `size` x `size` pixels."""
    mount = Mount(x_m=config.x_m, y_m=config.y_m, z_m=config.z_m)
    return PinholeCamera(
        name="recorded",
        model="pinhole",
        width=size,
        height=size,
        fov_deg=config.fov_deg,
        near_m=config.near_m,
        far_m=config.far_m,
        mount=mount,
    )


def changed_camera(camera: Camera, change: CameraChange | None) -> Camera:
    """Returns a camera with another mounting pose and focal length.

    Raises:
        UsageError: the lens does not permit the focal length.
    """
    if change is None:
        return camera
    mount = {key: getattr(camera.mount, key) + getattr(change, key) for key in Mount.model_fields}
    mount |= {key: math.remainder(angle, 360.0) for key, angle in mount.items() if key.endswith("_deg")}
    mount["z_m"] = max(mount["z_m"], _LEAST_HEIGHT_M)
    try:
        return type(camera).model_validate({**camera.model_dump(), "mount": mount, **_lens(camera, change.focal)})
    except ValidationError as error:
        problem = "; ".join(item["msg"].removeprefix("Value error, ") for item in error.errors())
        raise UsageError(
            f"camera {camera.name!r} does not permit {change.focal:g} times its focal length: {problem}. "
            "Give a smaller range camera.focal in the appearance"
        ) from error


def changed_sensor(sensor: Camera | Scan, change: CameraChange | None) -> Camera | Scan:
    """Returns the result of `changed_camera` for a camera; returns a lidar unchanged."""
    return sensor if isinstance(sensor, Lidar2d | Lidar3d) else changed_camera(sensor, change)


def _lens(camera: Camera, focal: float) -> dict[str, float]:
    """Returns the fields of a lens with another focal length; a panorama has none."""
    if isinstance(camera, PinholeCamera) and camera.fov_deg is not None:
        return {"fov_deg": math.degrees(2 * math.atan(math.tan(math.radians(camera.fov_deg) / 2) / focal))}
    if isinstance(camera, PinholeCamera | FisheyeCamera):
        fx, fy = camera.focal_px
        return {"fx_px": fx * focal, "fy_px": fy * focal}
    return {}
