"""Measures the CPU time of sensors in the built-in scenes and, for comparison, of a rendered frame in the same run.

python -m tests.benchmarks.sensors office hospital
"""

from __future__ import annotations

import functools
import os
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from factory.scenes.build import build_scene
from schemas.config import CameraConfig
from schemas.rig.cameras import PinholeCamera
from schemas.rig.noise import CameraNoise, ColourNoise, LidarNoise, StereoDepthNoise, StructuredLightNoise
from schemas.rig.sensors import Lidar3d, Mount
from schemas.scene import read_scene
from workers.geometry.pose import Pose
from workers.render.choose import open_renderer
from workers.sensors import NoiseKey, sense_colour, sense_depth, sense_lidar
from workers.sensors.rays import SceneRays

_REPETITIONS = 30
_STEPS_PER_SCAN = 6
_KEY = NoiseKey(1, 1, "sensor")
_NOISES = {
    "colour, shot and read noise": CameraNoise(colour=ColourNoise()),
    "colour, JPEG of quality 90": CameraNoise(colour=ColourNoise(has_electrons=False, jpeg_quality=90)),
    "depth, stereo": CameraNoise(depth=StereoDepthNoise(model="stereo")),
    "depth, structured light": CameraNoise(depth=StructuredLightNoise(model="structured_light")),
}


def cpu_ms(work: Callable[[], object]) -> tuple[float, float]:
    """Returns median and minimum of the CPU times of repeated calls, milliseconds."""
    work()
    times = []
    for _ in range(_REPETITIONS):
        begin = time.process_time()
        work()
        times.append(1e3 * (time.process_time() - begin))
    return float(np.median(times)), min(times)


def report(name: str, work: Callable[[], object], share: float = 1) -> None:
    """Prints one row."""
    median, least = cpu_ms(work)
    sys.stdout.write(f"  {name:32} {median * share:7.2f} ms   least {least * share:.2f}\n")


def measure(name: str, folder: Path) -> None:
    """Prints the rows of one scene."""
    scene = read_scene(build_scene(name, 0, folder))
    x, y = map(float, scene.spawns[len(scene.spawns) // 2])
    pose, row = Pose.planar(x, y, 0.5), np.array([[x, y, 0, np.cos(0.25), 0, 0, np.sin(0.25)]])
    sys.stdout.write(f"{name}\n")
    with open_renderer("gl") as renderer:
        renderer.load(scene, CameraConfig())
        frame = renderer.render(pose)
        report("rendered frame of 640 x 640", functools.partial(renderer.render, pose))
    for label, noise in _NOISES.items():
        camera = PinholeCamera(name="front", model="pinhole", width=640, height=640, fov_deg=90, noise=noise)
        sense = sense_colour if noise.colour else sense_depth
        image = frame.rgb[None] if noise.colour else frame.depth
        report(label, functools.partial(sense, camera, image, _KEY, 0))
    rays, lines = SceneRays(scene), tuple(range(15, -16, -2))
    for noise in (None, LidarNoise()):
        fields = {"samples": 1800, "range_min_m": 0.1, "range_max_m": 100, "mount": Mount(z_m=0.6), "noise": noise}
        lidar = Lidar3d(name="lidar", model="lidar3d", elevations_deg=lines, **fields)
        label = f"lidar per step, {'noise' if noise else 'clean'}"
        report(label, functools.partial(sense_lidar, rays, lidar, row, 0, 60, _KEY), 1 / _STEPS_PER_SCAN)


if __name__ == "__main__":
    os.environ["LP_NUM_THREADS"] = "0"
    with tempfile.TemporaryDirectory() as folder:
        for scene_name in sys.argv[1:] or ["office"]:
            measure(scene_name, Path(os.environ.get("MINIVLA_SCENES", folder)))
