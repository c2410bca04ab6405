"""Prints values of computations that enter episodes, so runs with other BLAS and numpy kernels can be compared."""

from __future__ import annotations

import hashlib
import io
import json
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from schemas.config import CameraConfig, TaskConfig
from schemas.measure import measure_track
from schemas.support.portable import product
from tests.builders.evaluation import room_job, room_package
from workers.geometry.camera import optical_pose, projection_matrix, view_matrix
from workers.geometry.mask_estimate import MaskEstimate
from workers.geometry.pose import Pose
from workers.planning import geodesic_m
from workers.sim.attempt import Success, run_attempt
from workers.sim.context import LoadedScene, SimulationContext

_MANY = 300


def main() -> None:
    """Prints one JSON object: the name of each computation with its digest or values."""
    job, package = room_job(1), room_package()
    with TemporaryDirectory() as folder, SimulationContext("gl") as stage:
        path = Path(folder, "room.scene")
        path.write_bytes(package)
        stage.load(path, job.scene_sha256)
        outcome = run_attempt(job, stage, io.BytesIO(), "test", lambda step: None)
        assert isinstance(outcome, Success), outcome
        found = {"episode": outcome.meta.content_digest, **_computed(stage.loaded(job.scene_sha256), job.target_id)}
    json.dump({"scene": hashlib.sha256(package).hexdigest(), **found}, sys.stdout)


def _computed(place: LoadedScene, target_id: str) -> dict[str, str]:
    rng, camera = np.random.default_rng(6), CameraConfig()
    target = place.compiled.info.target(target_id)
    tracks = rng.normal(size=(_MANY, 9, 7)).astype(np.float32)
    poses = [Pose(*row) for row in rng.normal(size=(_MANY, 7))]
    views = [product(projection_matrix(camera), view_matrix(optical_pose(pose, camera))) for pose in poses]
    starts = place.grid.centre_of(rng.integers(0, min(place.grid.occupancy.shape), (_MANY, 2)))
    look = MaskEstimate(place.compiled, target.instance_id, camera).evaluate
    return {
        "measures": _digest(str([measure_track(track, (0.3, 0.1, 0.7)) for track in tracks])),
        "views": _digest(str(np.array(views).tolist())),
        "ways": _digest(str([geodesic_m(place.grid, xy, target, TaskConfig()) for xy in starts])),
        "looks": _digest(str([look(x, y, yaw) for (x, y), yaw in zip(starts, rng.uniform(-3, 3, _MANY), strict=True)])),
    }


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


if __name__ == "__main__":
    main()
