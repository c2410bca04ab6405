"""Plans how an image of any camera model is composed of perspective images, called faces, in one atlas.

A camera with a narrow view needs one face; others need up to six, the sides of a cube. Pure functions. Does not render.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from schemas.errors import UsageError
from schemas.rig import Camera, DepthKind, PinholeCamera
from schemas.support.numpy_types import Floats
from schemas.support.portable import product
from workers.geometry.camera import OpticalPose, Perspective
from workers.geometry.lens import pixel_centres, unproject

_KEPT_PLANS = 16
_MAX_FACE_PX, _MAX_ATLAS_PX = 4096, 16_384
"""Largest side of a face and of the atlas, pixels: limits of software and hardware drivers."""
_ONE_FACE_REACH = 2.0
"""Largest distance from the optical axis on the plane z = 1 for a single face; wider views use a cube of faces."""
_MARGIN_PX = 2
"""Margin of a face around the pixels that are read, so interpolation never leaves the face."""
_WEIGHTS = 256
_AXES = np.array(
    (
        ((1, 0, 0), (0, 1, 0), (0, 0, 1)),  # front
        ((0, 0, 1), (0, 1, 0), (-1, 0, 0)),  # left
        ((-1, 0, 0), (0, 1, 0), (0, 0, -1)),  # back
        ((0, 0, -1), (0, 1, 0), (1, 0, 0)),  # right
        ((1, 0, 0), (0, 0, 1), (0, -1, 0)),  # top
        ((1, 0, 0), (0, 0, -1), (0, 1, 0)),  # bottom
    ),
    np.float64,
).transpose(0, 2, 1)
"""(6, 3, 3) rotations from the frame of each side of the cube to the optical frame."""


class Face(NamedTuple):
    """Perspective image in an atlas, at its left edge."""

    view: Perspective
    """Size, field of view and clip range."""
    rotation: Floats
    """(3, 3) rotation from the optical frame of the face to that of the camera."""
    top: int
    """First row in the atlas, pixels."""

    def optical(self, camera: OpticalPose) -> OpticalPose:
        """Returns the pose of the optical frame of the face, given that of the camera."""
        return OpticalPose(camera.eye, product(camera.rotation, self.rotation))


class Sampling(NamedTuple):
    """Places in the atlas from which an image of H x W pixels is sampled; indices refer to the flattened atlas."""

    nearest: NDArray[np.int32]
    """(H * W,) index of the nearest pixel; 0 for void pixels."""
    first: NDArray[np.int32]
    """(H * W,) index of the upper left of the four nearest pixels."""
    weights: NDArray[np.uint32]
    """(4, H * W) weights of the upper left, upper right, lower left and lower right pixel; their sum is 256."""
    reach: NDArray[np.float32]
    """(H * W,) factor from the depth in the atlas to that of the image."""
    void: NDArray[np.intp]
    """Indices of the pixels in which the camera sees nothing."""


@dataclass(frozen=True, eq=False)
class FacePlan:
    """Faces of a camera, and how its image is sampled from their atlas."""

    faces: tuple[Face, ...]
    """Faces, from top to bottom of the atlas."""
    width: int
    """Width of the atlas, pixels."""
    height: int
    """Height of the atlas, pixels."""
    sampling: Sampling | None
    """Sampling of the atlas; `None` if the atlas is the image."""


def plan_faces(camera: Camera) -> FacePlan:
    """Returns the plan of a camera; the plans of the most recently used lenses are kept.

    At every pixel, the faces have at least the resolution (pixels per radian) that the image has there along its rows
    or along its columns, whichever is lower. In addition, their resolution is nowhere below a minimum: the lowest
    resolution of the image along its rows or the lowest along its columns, whichever is higher. Near its poles, a
    panorama has a higher resolution than the faces.

    Raises:
        UsageError: the faces would be larger than the drivers support.
    """
    return _plan(camera.lens())


@functools.lru_cache(maxsize=_KEPT_PLANS)
def _plan(camera: Camera) -> FacePlan:
    if isinstance(camera, PinholeCamera) and not camera.is_distorted:
        face = Face(_direct_view(camera), np.eye(3), 0)
        return FacePlan((face,), camera.width, camera.height, None)
    rays = unproject(camera, pixel_centres(camera))
    sides = _sides(rays)
    plane = _on_sides(rays, sides)
    focal = max(_finest(plane, sides), _sharpest(rays))
    return _arrange(camera, rays, sides=sides, plane=plane, focal=focal)


def _direct_view(camera: PinholeCamera) -> Perspective:
    if camera.fov_deg is not None:
        half = math.tan(math.radians(camera.fov_deg) / 2)
        halves = half, half * camera.height / camera.width
    else:
        fx, fy = camera.focal_px
        halves = camera.width / 2 / fx, camera.height / 2 / fy
    return Perspective(
        camera.width, camera.height, half=halves, centre=camera.centre_px, near_m=camera.near_m, far_m=camera.far_m
    )


def _sides(rays: Floats) -> NDArray[np.int8]:
    """Returns the side of the cube (H, W) that each ray passes through; -1 without a ray, 0 if one face suffices."""
    seen = ~np.isnan(rays[..., 2])
    with np.errstate(divide="ignore", invalid="ignore"):
        reach = np.abs(rays[..., :2]).max(axis=-1) / rays[..., 2]
    if (rays[seen][:, 2] > 0).all() and reach[seen].max(initial=0.0) <= _ONE_FACE_REACH:
        return np.where(seen, 0, -1).astype(np.int8)
    height = np.nan_to_num(rays) @ _AXES[:, :, 2].T  # (H, W, 6) component along the axis of each side
    return np.where(seen, height.argmax(axis=-1), -1).astype(np.int8)


def _on_sides(rays: Floats, sides: NDArray[np.int8]) -> Floats:
    """Returns the points (H, W, 2) in which the rays pass through the plane z = 1 of their side."""
    plane = np.full((*sides.shape, 2), np.nan)
    for side in range(len(_AXES)):
        chosen = sides == side
        local = rays[chosen] @ _AXES[side]
        plane[chosen] = local[:, :2] / local[:, 2:]
    return plane


def _sharpest(rays: Floats) -> float:
    """Returns the lowest resolution along rows or the lowest along columns, whichever is higher, pixels per radian."""
    steps = [np.linalg.norm(np.diff(rays, axis=axis), axis=-1) for axis in (0, 1)]
    return float(1 / min(np.nanmax(step) for step in steps))


def _finest(plane: Floats, sides: NDArray[np.int8]) -> float:
    """Returns a focal length, pixels, at which each image pixel is at least one face pixel away from its right or its
    lower neighbour."""
    across = np.linalg.norm(np.diff(plane, axis=1), axis=-1)[:-1]
    down = np.linalg.norm(np.diff(plane, axis=0), axis=-1)[:, :-1]
    corner = sides[:-1, :-1]
    whole = (corner >= 0) & (corner == sides[:-1, 1:]) & (corner == sides[1:, :-1])
    return float(1 / np.maximum(across, down)[whole].min(initial=1.0))


def _arrange(camera: Camera, rays: Floats, sides: NDArray[np.int8], plane: Floats, focal: float) -> FacePlan:
    """Places the faces below each other in the atlas; returns them with the sampling of the atlas."""
    used = [side for side in range(len(_AXES)) if (sides == side).any()]
    lows = [np.floor(plane[sides == side].min(axis=0) * focal).astype(int) - _MARGIN_PX for side in used]
    highs = [np.ceil(plane[sides == side].max(axis=0) * focal).astype(int) + _MARGIN_PX for side in used]
    sizes = [high - low for low, high in zip(lows, highs, strict=True)]
    width, height = int(max(size[0] for size in sizes)), int(sum(size[1] for size in sizes))
    if max(map(max, sizes)) > _MAX_FACE_PX or height > _MAX_ATLAS_PX:
        raise UsageError(
            f"the {camera.model} camera of {camera.width} x {camera.height} pixels has up to {focal:.0f} pixels per "
            f"radian, so its faces need {width} x {height} pixels; at most {_MAX_FACE_PX} x {_MAX_ATLAS_PX} are "
            "possible: "
            "reduce its resolution or distortion"
        )
    tops = np.concatenate(([0], np.cumsum([size[1] for size in sizes])))
    faces, places = [], np.zeros_like(plane)
    # halved for a cube: its faces clip by depth, which at a corner is the distance divided by 1.73
    near = camera.near_m if len(used) == 1 else camera.near_m / 2
    for side, low, size, top in zip(used, lows, sizes, tops.tolist(), strict=False):
        columns, rows = map(int, size)
        half = columns / 2 / focal, rows / 2 / focal
        view = Perspective(
            columns, rows, half=half, centre=(float(-low[0]), float(-low[1])), near_m=near, far_m=camera.far_m
        )
        faces.append(Face(view, _AXES[side], top))
        places[sides == side] = plane[sides == side] * focal - low + (0, top)
    sampling = _sample(camera, rays, sides, places, faces, width)
    return FacePlan(tuple(faces), width, height, sampling)


def _sample(
    camera: Camera, rays: Floats, sides: NDArray[np.int8], places: Floats, faces: list[Face], width: int
) -> Sampling:
    void = np.flatnonzero(sides < 0)
    places = places.reshape(-1, 2)
    places[void] = 0.5
    corner = places - 0.5
    first = np.floor(corner).astype(np.int64)
    first[void] = 0
    share = corner - first
    across = np.rint(share[:, 0] * _WEIGHTS)
    down = share[:, 1]
    lower_right, lower_left = np.rint(across * down), np.rint((_WEIGHTS - across) * down)
    weights = np.stack((_WEIGHTS - across - lower_left, across - lower_right, lower_left, lower_right))
    nearest = np.floor(places).astype(np.int64)
    columns, rows = nearest.T
    return Sampling(
        (rows * width + columns).astype(np.int32),
        (first[:, 1] * width + first[:, 0]).astype(np.int32),
        weights=weights.astype(np.uint32),
        reach=_reach(camera, rays, faces, columns, rows),
        void=void,
    )


def _reach(
    camera: Camera, rays: Floats, faces: list[Face], columns: NDArray[np.int64], rows: NDArray[np.int64]
) -> NDArray[np.float32]:
    """Returns the factor from the axial depth of a face, at the centre of its pixel, to the depth of the image."""
    reach = np.empty(len(rows))
    for face in faces:
        chosen = (rows >= face.top) & (rows < face.top + face.view.height)
        across, down = face.view.steps()
        x, y = across[columns[chosen].clip(max=face.view.width - 1)], down[rows[chosen] - face.top]
        reach[chosen] = np.sqrt(x * x + y * y + 1)
    if camera.depth is DepthKind.AXIAL:
        reach *= np.nan_to_num(rays[..., 2].ravel())
    return reach.astype(np.float32)
