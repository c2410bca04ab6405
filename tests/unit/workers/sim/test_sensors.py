"""A rig whose measurements exceed the size of a bundle is refused after a few samples."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from schemas.errors import WorldError
from schemas.rig import Lidar3d, Mount, Rig
from tests.builders.scene import box_room
from workers.sensors.observation import Trajectory
from workers.sensors.rays import SceneRays
from workers.sim.recording import require_room

LIDAR = Lidar3d(
    name="lidar", model="lidar3d", rate_hz=10, mount=Mount(z_m=0.6), samples=360, elevations_deg=(5, 0, -5),
    range_min_m=0.1, range_max_m=20,
)  # fmt: skip
RIG = Rig(name="dense", sensors=(LIDAR,))
STEPS = 900
TRACK = Trajectory(np.tile((0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0), (STEPS, 1)), np.zeros((STEPS, 2)), 60, 1, 7)
PLAIN_BYTES = 150 * 3 * 360 * (4 + 2 + 4)


def scene(casts: list[int]) -> Any:
    """Returns the room of boxes; each scan appends a number to `casts`."""
    rays = SceneRays(box_room())

    def count() -> SceneRays:
        casts.append(len(casts))
        return rays

    return SimpleNamespace(rays=count)


def test_a_rig_that_does_not_fit_into_a_bundle_is_refused_after_three_measurements() -> None:
    casts: list[int] = []
    with pytest.raises(WorldError, match=r"ep_000007: 900 steps of rig 'dense', which would store .*: lower rate_hz"):
        require_room(RIG, TRACK, scene(casts), PLAIN_BYTES // 20)
    assert len(casts) == 3


def test_a_rig_that_fits_without_compression_is_not_sampled() -> None:
    casts: list[int] = []
    require_room(RIG, TRACK, scene(casts), PLAIN_BYTES)
    assert casts == []


def test_a_rig_that_fits_only_with_compression_is_accepted() -> None:
    casts: list[int] = []
    require_room(RIG, TRACK, scene(casts), PLAIN_BYTES - 1)
    assert len(casts) == 3
