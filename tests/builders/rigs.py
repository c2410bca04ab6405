"""A small rig with noise, and a dataset that stores its measurements."""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from pathlib import Path

from schemas.rig import Rig

SMALL_RIG = """
name = "small"

[[sensors]]
name = "front"
model = "pinhole"
rate_hz = 10
width = 96
height = 64
fov_deg = 90
outputs = ["rgb", "depth", "ids", "normals", "flow"]
mount = { x_m = 0.2, z_m = 0.5 }
noise = { colour = {}, depth = { model = "stereo" } }

[[sensors]]
name = "scan"
model = "lidar2d"
rate_hz = 5
samples = 90
range_min_m = 0.1
range_max_m = 20
mount = { x_m = 0.2, z_m = 0.5 }
noise = {}

[[sensors]]
name = "imu"
model = "imu"
rate_hz = 10
mount = { x_m = 0.2, z_m = 0.5 }
noise = {}

[[sensors]]
name = "wheels"
model = "odometry"
noise = {}
"""
"""TOML file of a rig with one sensor of each kind; a drive can be rendered with it in seconds."""


def write_rig(folder: Path) -> Path:
    """Writes the rig to a folder and returns its path."""
    path = folder / "small.toml"
    path.write_text(SMALL_RIG)
    return path


def small_rig(*, has_noise: bool = True) -> Rig:
    """Returns the rig without optical flow, which cannot be measured during a drive."""
    data = tomllib.loads(SMALL_RIG)
    data["sensors"][0]["outputs"].remove("flow")
    for sensor in data["sensors"]:
        sensor["noise"] = sensor["noise"] if has_noise else None
    return Rig.model_validate(data)


def render_rigged(root: Path, states: Path, factory: Callable[..., object]) -> None:
    """Renders a states dataset with the small rig into `root`, with one worker. Needs an EGL driver."""
    rig = write_rig(root.parent)
    factory("render", states, "--rig", rig, "-o", root, "--workers", 1, "--renderer", "gl")
