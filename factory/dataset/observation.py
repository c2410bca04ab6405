"""Observes an episode with the cameras of a rig, by rendering from its recorded poses. Reads no file."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from factory.dataset.bundle import EpisodeBundle
from schemas.errors import UsageError
from schemas.rig import Camera, CameraOutput, DepthKind, Rig
from schemas.support.suggest import did_you_mean
from workers.geometry.camera import mounted_pose
from workers.geometry.lens import axial_share, optical_flow
from workers.geometry.pose import Pose
from workers.render import CameraImage


class CameraObservation(NamedTuple):
    """Images of one camera at one step; `None` for an image that is not an output of the camera."""

    rgb: NDArray[np.uint8] | None = None
    """(height, width, 3) sRGB, top row first."""
    depth: NDArray[np.float32] | None = None
    """(height, width) metres, axial or radial as the camera has it; 0 where no surface was hit."""
    ids: NDArray[np.uint16] | None = None
    """(height, width) instance ids, described by `Episode.instances`; 0 is background."""
    normals: NDArray[np.float32] | None = None
    """(height, width, 3) unit normals in the optical frame (x right, y down, z forward); 0 where no surface was hit."""
    flow: NDArray[np.float32] | None = None
    """(height, width, 2) displacement to the right and down until the camera's next image, pixels; NaN where it is not
    defined. `None` if the episode ends before that image."""


def due_cameras(rig: Rig, control_hz: int, t: int, names: Sequence[str] | None = None) -> tuple[Camera, ...]:
    """Returns the cameras of a rig that take an image at step t.

    Args:
        rig: sensors.
        control_hz: control rate, Hz.
        t: step.
        names: names of cameras; `None` is all.

    Raises:
        UsageError: the rig has no camera of that name.
    """
    known = {camera.name: camera for camera in rig.cameras}
    for name in names or ():
        if name not in known:
            raise UsageError(
                f"rig {rig.name!r} has no camera {name!r}; its cameras: {', '.join(known)}{did_you_mean(name, known)}"
            )
    chosen = known.values() if names is None else [known[name] for name in names]
    return tuple(camera for camera in chosen if t % camera.stride(control_hz) == 0)


def observe(bundle: EpisodeBundle, camera: Camera, t: int) -> CameraObservation:
    """Returns the outputs of a camera at step t of an episode.

    Raises:
        ArchiveCorrupt: the scene package is missing or was changed.
        UsageError: the camera has noise, which is not supported here.
        WorldError: this machine cannot render.
    """
    if camera.noise is not None:
        raise UsageError(f"camera {camera.name!r} has noise, which `observe` does not add: remove noise from the rig")
    image = bundle.render_camera(t, camera)
    parts = {
        CameraOutput.RGB: image.rgb,
        CameraOutput.DEPTH: image.depth,
        CameraOutput.IDS: image.ids,
        CameraOutput.NORMALS: image.normals,
    }
    flow = _flow(bundle, camera, t, image) if CameraOutput.FLOW in camera.outputs else None
    return CameraObservation(**{str(name): part for name, part in parts.items() if name in camera.outputs}, flow=flow)  # type: ignore[arg-type]


def _flow(bundle: EpisodeBundle, camera: Camera, t: int, image: CameraImage) -> NDArray[np.float32] | None:
    poses, later = bundle.arrays.poses, t + camera.stride(bundle.meta.job.task.control_hz)
    if later >= len(poses):
        return None
    distance = image.depth.astype(np.float64)
    if camera.depth is DepthKind.AXIAL:
        distance /= axial_share(camera)
    eyes = [mounted_pose(Pose.of(poses[step]), camera.mount) for step in (t, later)]
    return optical_flow(camera, distance, *eyes).astype(np.float32)
