"""Composes the image of any camera from an atlas of perspective faces. Does not render.

Design: docs/design/rendering.md#cameras-are-composed-of-faces.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from schemas.rig import Camera, CameraOutput, DepthKind
from schemas.support.numpy_types import Floats
from workers.geometry.camera import OpticalPose, mounted_pose
from workers.geometry.faces import FacePlan, Sampling, plan_faces
from workers.geometry.lens import axial_share
from workers.geometry.pose import Pose
from workers.geometry.resample import resample_colour, resample_depth, resample_ids, resample_normals
from workers.render import CameraImage, RenderedAtlas

_CODE_STEPS = 4095
"""Steps of each octahedral coordinate of a normal, see `shaders.NORMALS`."""


class FaceRenderer(Protocol):
    """Renderer of the faces of a camera."""

    def render_faces(self, plan: FacePlan, optical: OpticalPose, normals: bool = False) -> RenderedAtlas:
        """Returns the atlas of the faces."""


def compose_image(renderer: FaceRenderer, camera: Camera, pose: Pose) -> CameraImage:
    """Renders the faces of a camera for a pose of base_link, and returns its image."""
    plan, optical = plan_faces(camera), mounted_pose(pose, camera.mount)
    atlas = renderer.render_faces(plan, optical, CameraOutput.NORMALS in camera.outputs)
    normals = None if atlas.normals is None else decode_normals(atlas.normals, atlas.depth, optical.rotation)
    if plan.sampling is None:
        is_radial = camera.depth is DepthKind.RADIAL
        depth = (atlas.depth / axial_share(camera)).astype(np.float32) if is_radial else atlas.depth
        return CameraImage(atlas.rgb, depth, atlas.ids, normals)
    return _resampled(camera, atlas, plan.sampling, normals)


def _resampled(
    camera: Camera, atlas: RenderedAtlas, sampling: Sampling, normals: NDArray[np.float32] | None
) -> CameraImage:
    shape = camera.height, camera.width
    depth = resample_depth(atlas.depth, sampling, camera.far_m).reshape(shape)
    ids = resample_ids(atlas.ids, sampling).reshape(shape)
    ids[depth == 0] = 0
    return CameraImage(
        resample_colour(atlas.rgb, sampling).reshape(*shape, 3),
        depth,
        ids,
        None if normals is None else resample_normals(normals, sampling).reshape(*shape, 3),
    )


def decode_normals(codes: NDArray[np.uint8], depth: NDArray[np.float32], rotation: Floats) -> NDArray[np.float32]:
    """Returns unit normals (H, W, 3) in a frame; 0 where the depth is 0.

    Args:
        codes: (H, W, 3) octahedral codes of normals in the world frame, as `shaders.NORMALS` writes them.
        depth: (H, W) depth, metres.
        rotation: (3, 3) rotation from the frame to the world.
    """
    high, middle, low = (codes[..., channel].astype(np.int32) for channel in range(3))
    folded = np.stack((high << 4 | middle >> 4, (middle & 15) << 8 | low), axis=-1) * np.float32(2 / _CODE_STEPS) - 1
    rise = 1 - np.abs(folded).sum(axis=-1)
    fold = np.maximum(-rise, 0)[..., None]
    level = folded - np.copysign(fold, folded)
    normals = np.concatenate((level, rise[..., None]), axis=-1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    turned = (normals @ rotation.astype(np.float32)).astype(np.float32)
    turned[depth == 0] = 0
    return np.asarray(turned)
