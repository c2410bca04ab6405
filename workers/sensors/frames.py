"""Poses of sensors along a trajectory: mounting pose, world frame, and poses between control steps.

Pure functions on arrays of poses x, y, z, qw, qx, qy, qz of base_link, as recorded. Uses no BLAS, so the results
are bit-identical on all processors.
"""

from __future__ import annotations

import numpy as np

from schemas.rig.sensors import Mount
from schemas.support.numpy_types import Floats
from workers.geometry.camera import mount_rotation


def rotations(quaternions: Floats) -> Floats:
    """Returns rotation matrices (N, 3, 3) of unit quaternions (N, 4) w, x, y, z."""
    w, x, y, z = quaternions.T
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return np.array(rows).transpose(2, 0, 1)


def sensor_poses(poses: Floats, mount: Mount) -> tuple[Floats, Floats]:
    """Returns positions (N, 3), metres, and rotations (N, 3, 3) of a sensor frame in the world for poses (N, 7)."""
    base = rotations(poses[:, 3:])
    offset = np.array((mount.x_m, mount.y_m, mount.z_m))
    return poses[:, :3] + (base * offset).sum(axis=2), _products(base, mount_rotation(mount)[None])


def turned(matrices: Floats, vectors: Floats) -> Floats:
    """Returns vectors (..., 3) after rotations (N, 3, 3), which are broadcast to the shape of the vectors.

    The result stores all x, then all y, then all z, which is faster for large arrays.
    """
    shape = np.broadcast_shapes(matrices.shape[:-1], vectors.shape)[:-1]
    result = np.empty((3, *shape))
    x, y, z = vectors[..., 0], vectors[..., 1], vectors[..., 2]
    for axis, out in enumerate(result):
        row = matrices[..., axis, :]
        np.multiply(row[..., 0], x, out=out)
        out += row[..., 1] * y
        out += row[..., 2] * z
    return np.moveaxis(result, 0, -1)


def _products(left: Floats, right: Floats) -> Floats:
    return np.asarray((left[:, :, :, None] * right[:, None, :, :]).sum(axis=2))


def poses_at(poses: Floats, steps: Floats) -> Floats:
    """Returns poses (N, 7) at fractional control steps (N,) of a trajectory (T, 7).

    Positions and quaternions are interpolated linearly and normalised; between two control steps the robot turns by
    less than 0.03 rad, for which this differs from the great arc by less than 1e-6 rad. Before the first step the
    robot is at rest.
    """
    last = len(poses) - 1
    times = np.clip(steps, 0, last)
    before = np.minimum(times.astype(np.int64), max(last - 1, 0))
    start, end = poses[before], poses[np.minimum(before + 1, last)]
    sign = np.where((start[:, 3:] * end[:, 3:]).sum(axis=1) < 0, -1.0, 1.0)
    end = np.concatenate((end[:, :3], end[:, 3:] * sign[:, None]), axis=1)
    mixed = start + (times - before)[:, None] * (end - start)
    mixed[:, 3:] /= np.sqrt((mixed[:, 3:] ** 2).sum(axis=1, keepdims=True))
    return np.asarray(mixed)
