"""Measures CPU time and memory of a simulation that switches between layouts. Arguments: `PACKAGE...`.

Loads all packages one after the other, two times. Each load has the steps of an attempt: reading, collider, grid,
upload to the renderer, physics and the first frame. Packages are files of a scene cache, next to their textures.
Builds no layout.
"""

from __future__ import annotations

import hashlib
import os
import resource
import sys
import time
from pathlib import Path

import numpy as np

from factory.bench.machine import resident_mib
from schemas.config import CameraConfig, RobotConfig, TaskConfig
from workers.geometry.pose import Pose
from workers.physics.world import World
from workers.sim.context import SimulationContext


def main() -> None:
    """Prints the CPU time of the switches in the second pass over the packages, and the memory."""
    packages = [Path(argument) for argument in sys.argv[1:]]
    digests = [hashlib.sha256(package.read_bytes()).hexdigest() for package in packages]
    times = []
    with SimulationContext() as simulation:
        for _ in range(2):
            times = [switch(simulation, *each) for each in zip(packages, digests, strict=True)]
            sys.stdout.write(f"{len(packages)} layouts loaded, {resident_mib():.0f} MiB\n")
    median, high = np.percentile(times, (50, 90))
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss >> 10
    load = os.getloadavg()[0]
    sys.stdout.write(f"switch: {median:.3f} s CPU, 90 % within {high:.3f} s; at most {peak} MiB; load {load:.0f}\n")


def switch(simulation: SimulationContext, package: Path, sha256: str) -> float:
    """Loads a layout and renders its first frame; returns the CPU time, seconds."""
    begin = time.process_time()
    loaded = simulation.load(package, sha256)
    x, y = map(float, loaded.compiled.spawns[0])
    simulation.renderer.load(loaded.compiled, CameraConfig())
    with World(loaded.compiled, loaded.collider, RobotConfig(), TaskConfig().control_hz):
        simulation.renderer.render(Pose.planar(x, y, 0.0, z=loaded.compiled.info.floor_height_m))
    return time.process_time() - begin


if __name__ == "__main__":
    main()
