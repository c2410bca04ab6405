"""Draws a change of the cameras, and applies it to a camera of a rig or to the recorded camera. Pure functions."""

from __future__ import annotations

import math

from pydantic import ValidationError

from schemas.appearance import CameraChange, CameraRanges
from schemas.config import CameraConfig
from schemas.errors import UsageError
from schemas.rig import Camera, FisheyeCamera, Lidar2d, Lidar3d, Mount, PinholeCamera
from workers.appearance.factor_stream import FactorStream

Scan = Lidar2d | Lidar3d
_LEAST_HEIGHT_M = 0.02


def draw_camera(ranges: CameraRanges, stream: FactorStream) -> CameraChange:
    """Returns the change of the cameras of an episode."""
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
        found = "; ".join(item["msg"].removeprefix("Value error, ") for item in error.errors())
        raise UsageError(
            f"camera {camera.name!r} does not permit {change.focal:g} times its focal length: {found}. "
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
