"""Models of cameras: pinhole with Brown-Conrady distortion, fisheye, and equirectangular.

An image spans [0, width) and [0, height), so the centre of the first pixel is (0.5, 0.5); a calibration of OpenCV,
which has that centre at (0, 0), needs 0.5 px added to its principal point. Projects no points and renders nothing.
"""

from __future__ import annotations

import math
from enum import StrEnum
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from schemas.base import Finite, Positive
from schemas.rig.distortion import first_fold, fisheye_radii, undistort
from schemas.rig.noise import CameraNoise
from schemas.rig.sensors import Mount, MountedSensor

MAX_SIDE_PX = 4096
"""Largest width and height of an image, pixels."""
MAX_PIXELS = 2048 * 2048
"""Largest number of pixels of an image."""
_Side = Annotated[int, Field(ge=8, le=MAX_SIDE_PX)]
_Coefficient = Annotated[float, Field(ge=-1000, le=1000)]


class DepthKind(StrEnum):
    """Meaning of a depth image."""

    AXIAL = "axial"  # distance along the optical axis
    RADIAL = "radial"  # distance from the optical centre


class CameraOutput(StrEnum):
    """Image of a camera."""

    RGB = "rgb"  # colour
    DEPTH = "depth"  # metric depth
    IDS = "ids"  # instance ids
    NORMALS = "normals"  # surface normals
    FLOW = "flow"  # optical flow to the next measurement


class _Camera(MountedSensor):
    width: _Side
    """Width of the image, pixels."""
    height: _Side
    """Height of the image, pixels."""
    near_m: Positive = 0.05
    """Start of the clip range along the optical axis, metres."""
    far_m: Positive = 30.0
    """End of the clip range along the optical axis, metres; the depth of pixels beyond it is 0."""
    outputs: Annotated[tuple[CameraOutput, ...], Field(min_length=1, max_length=5)] = (
        CameraOutput.RGB,
        CameraOutput.DEPTH,
        CameraOutput.IDS,
    )
    """Images that the camera records."""
    noise: CameraNoise | None = None
    """Noise of colour and depth; null is a perfect camera."""

    @property
    def is_rectified(self) -> bool:
        """Whether straight lines are straight in the image, and depth is axial."""
        return False

    def lens(self) -> Self:
        """Returns a copy with constant name, rate, mount, outputs and noise, so equal lenses give equal copies."""
        plain = {"name": "lens", "rate_hz": None, "mount": Mount(), "outputs": (CameraOutput.RGB,), "noise": None}
        return self.model_copy(update=plain)

    @model_validator(mode="after")
    def _ranges_are_ordered(self) -> Self:
        if self.near_m >= self.far_m:
            raise ValueError(f"near_m {self.near_m:g} must be less than far_m {self.far_m:g}: swap them")
        if self.width * self.height > MAX_PIXELS:
            raise ValueError(
                f"{self.width} x {self.height} pixels are too many: reduce width or height, so the image has at "
                f"most {MAX_PIXELS} pixels"
            )
        if self.noise is not None and self.noise.depth is not None and not self.is_rectified:
            raise ValueError(
                "noise.depth needs model 'pinhole' with depth 'axial' and without distortion, because depth is "
                "triangulated in rectified images: choose such a camera, or remove noise.depth"
            )
        if len(set(self.outputs)) < len(self.outputs):
            raise ValueError(f"outputs {', '.join(self.outputs)}: name each output once")
        return self


class _CentredCamera(_Camera):
    fx_px: Positive | None = None
    """Focal length along the rows, pixels."""
    fy_px: Positive | None = None
    """Focal length along the columns, pixels; null is `fx_px`."""
    cx_px: Finite | None = None
    """Column of the principal point, pixels from the left edge; null is the middle."""
    cy_px: Finite | None = None
    """Row of the principal point, pixels from the top edge; null is the middle."""

    @property
    def centre_px(self) -> tuple[float, float]:
        """Column and row of the principal point, pixels."""
        return (
            self.width / 2 if self.cx_px is None else self.cx_px,
            self.height / 2 if self.cy_px is None else self.cy_px,
        )

    @model_validator(mode="after")
    def _centre_is_near_the_image(self) -> Self:
        for key, value, side in zip(("cx_px", "cy_px"), self.centre_px, (self.width, self.height), strict=True):
            if not -side <= value <= 2 * side:
                raise ValueError(f"{key} {value:g} is far outside of the image, 0 to {side} px: give it in pixels")
        return self


class PinholeCamera(_CentredCamera):
    """Perspective camera; give `fov_deg`, or `fx_px` of a calibration."""

    model: Literal["pinhole"]
    """Camera model."""
    fov_deg: Annotated[float, Field(gt=1, lt=170)] | None = None
    """Horizontal field of view without distortion, degrees; pixels are square."""
    distortion: tuple[_Coefficient, _Coefficient, _Coefficient, _Coefficient, _Coefficient] = (0.0, 0.0, 0.0, 0.0, 0.0)
    """Brown-Conrady coefficients k1, k2, p1, p2, k3, the order of OpenCV."""
    depth: DepthKind = DepthKind.AXIAL
    """Meaning of the depth image."""

    @property
    def focal_px(self) -> tuple[float, float]:
        """Focal lengths along rows and columns, pixels."""
        if self.fov_deg is not None:
            focal = self.width / 2 / math.tan(math.radians(self.fov_deg) / 2)
            return focal, focal
        assert self.fx_px is not None
        return self.fx_px, self.fy_px or self.fx_px

    @property
    def is_distorted(self) -> bool:
        """Whether a distortion coefficient is not 0."""
        return any(self.distortion)

    @property
    def is_rectified(self) -> bool:
        """Whether straight lines are straight in the image, and depth is axial."""
        return not self.is_distorted and self.depth is DepthKind.AXIAL

    @model_validator(mode="after")
    def _is_pinhole(self) -> Self:
        if (self.fov_deg is None) == (self.fx_px is None):
            raise ValueError("give either fov_deg or fx_px: a pinhole camera needs one of them, and not both")
        if self.fov_deg is not None and self.fy_px is not None:
            raise ValueError("fy_px is given without fx_px: give both, or fov_deg only")
        border = self._border()
        widest = np.abs(border if not self.is_distorted else undistort(border, self.distortion)).max()
        if math.isnan(widest):
            raise ValueError(
                f"distortion {list(self.distortion)} folds over within the image: reduce the coefficients or the "
                "image, or use model 'fisheye'"
            )
        if widest > math.tan(math.radians(85)):
            raise ValueError(
                f"the field of view reaches {math.degrees(math.atan(widest)):.0f} degrees from the optical axis; a "
                "pinhole camera can show 85: increase the focal length, or use model 'fisheye'"
            )
        return self

    def _border(self) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
        """Returns distorted points (N, 2) on the border of the image, in focal lengths from the principal point."""
        share = np.linspace(0, 1, 65)
        zero, one = np.zeros_like(share), np.ones_like(share)
        sides = ((share, zero), (share, one), (zero, share), (one, share))
        points = np.concatenate([np.column_stack(side) for side in sides]) * (self.width, self.height)
        return (points - self.centre_px) / self.focal_px


class FisheyeCamera(_CentredCamera):
    """Camera with OpenCV's fisheye model; pixels outside of the image circle are black, with depth and id 0."""

    model: Literal["fisheye"]
    """Camera model."""
    fov_deg: Annotated[float, Field(gt=1, le=320)]
    """Angle of the image circle, degrees; the circle touches the nearer sides of the image unless `fx_px` is given."""
    distortion: tuple[_Coefficient, _Coefficient, _Coefficient, _Coefficient] = (0.0, 0.0, 0.0, 0.0)
    """Coefficients k1 to k4 of `cv2.fisheye`; zeros give the equidistant projection."""
    depth: DepthKind = DepthKind.RADIAL
    """Meaning of the depth image; `axial` needs a field of view below 180 degrees."""

    @property
    def half_fov_rad(self) -> float:
        """Angle from the optical axis to the edge of the image circle, radians."""
        return math.radians(self.fov_deg) / 2

    @property
    def focal_px(self) -> tuple[float, float]:
        """Focal lengths along rows and columns, pixels."""
        if self.fx_px is not None:
            return self.fx_px, self.fy_px or self.fx_px
        focal = min(self.width, self.height) / 2 / float(fisheye_radii(np.array(self.half_fov_rad), self.distortion))
        return focal, focal

    @model_validator(mode="after")
    def _is_fisheye(self) -> Self:
        fold = first_fold(self.half_fov_rad, self.distortion)
        if fold is not None:
            raise ValueError(
                f"distortion {list(self.distortion)} folds over at {math.degrees(fold):.1f} degrees from the optical "
                f"axis, within the image circle: reduce the coefficients, or fov_deg below {2 * math.degrees(fold):.0f}"
            )
        if self.fy_px is not None and self.fx_px is None:
            raise ValueError("fy_px is given without fx_px: give both, or none")
        if self.depth is DepthKind.AXIAL and self.fov_deg >= 180:
            raise ValueError(f"depth 'axial' is not defined at {self.fov_deg:g} degrees: choose depth 'radial'")
        return self


class EquirectangularCamera(_Camera):
    """Panorama of all directions: columns are azimuth, from the rear over the left side to the rear; rows elevation.

    The optical axis is in the middle of the image; depth is radial.
    """

    model: Literal["equirectangular"]
    """Camera model."""
    top_deg: Annotated[float, Field(ge=-89, le=90)] = 90.0
    """Elevation of the top edge, degrees."""
    bottom_deg: Annotated[float, Field(ge=-90, le=89)] = -90.0
    """Elevation of the bottom edge, degrees."""
    depth: Literal[DepthKind.RADIAL] = DepthKind.RADIAL
    """Meaning of the depth image; a panorama has no axial depth."""

    @model_validator(mode="after")
    def _is_upright(self) -> Self:
        if self.bottom_deg >= self.top_deg:
            raise ValueError(f"bottom_deg {self.bottom_deg:g} must be less than top_deg {self.top_deg:g}: swap them")
        return self


Camera = PinholeCamera | FisheyeCamera | EquirectangularCamera
"""Any camera."""
