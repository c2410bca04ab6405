"""Where an attempt starts: tiered draws on the occupancy grid, then a check in physics (paper Sec. III-D).

Draws come from the attempt's generator only; the grid part is pure.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from schemas.job import Job
from schemas.scene import Target
from schemas.terms import TIER_RANGE_M, ExpertName, Tier
from workers.grid import straight_end
from workers.plan import geodesic_field, pose_table
from workers.pose import Pose
from workers.stage import LoadedScene
from workers.world import World

ARRIVAL_RADIUS_M = 0.97
"""Where the robot comes to rest within the success circle, metres from the centroid."""
_CLOSEST_FAR_M = 1.5
"""Least distance to the target's centroid of the planner's far starts, metres."""

__all__ = ["draw_poses", "is_spawn_firm"]


def draw_poses(job: Job, target: Target, place: LoadedScene, rng: np.random.Generator) -> Iterator[Pose]:
    """Yields start poses that fit on the grid, at most `job.spawn.physics_draws` of them.

    Near and mid: uniform distance and bearing around the target, facing it within the heading noise. Far: a
    surveyed floor point and a uniform heading. Experts that drive straight get starts whose straight line to the
    success circle is free; the planner gets any start on the connected floor and, far, one whose way is not too long.

    Args:
        job: gives tier, expert and spawn settings.
        target: the object to approach.
        place: the scene with its grid.
        rng: the attempt's generator; consumed in a fixed order.
    """
    z = place.scene.info.floor_height_m
    for _ in range(job.spawn.physics_draws):
        found = _draw_on_grid(job, target, place, rng)
        if found is None:
            return
        yield Pose.planar(*found, z=z)


def is_spawn_firm(world: World, pose: Pose, job: Job) -> bool:
    """Places the robot, lets it stand for the warm-up steps, and says whether it stayed (DESIGN 3.12).

    The paper's displacement test alone misses overlaps of a few centimetres, hence the penetration test before it.
    """
    spawn = job.spawn
    world.place(pose.x, pose.y, pose.yaw)
    if world.deepest_penetration() > spawn.max_penetration_m:
        return False
    for _ in range(spawn.warmup_steps):
        world.step()
    after = world.pose()
    return math.hypot(after.x - pose.x, after.y - pose.y) <= spawn.max_displacement_m


def _draw_on_grid(
    job: Job, target: Target, place: LoadedScene, rng: np.random.Generator
) -> tuple[float, float, float] | None:
    surveyed = _surveyed_points(job, target, place) if job.tier is Tier.FAR else None
    if surveyed is not None and len(surveyed) == 0:
        return None
    for _ in range(job.spawn.grid_draws):
        x, y, yaw = _draw_around(job, target, rng) if surveyed is None else _draw_among(surveyed, rng)
        if place.grid.is_pose_free(x, y, yaw, job.spawn.margin_m) and _can_start(job, target, place, x, y, yaw):
            return x, y, yaw
    return None


def _draw_around(job: Job, target: Target, rng: np.random.Generator) -> tuple[float, float, float]:
    low, high = TIER_RANGE_M[job.tier]
    distance, bearing = rng.uniform(low, high), rng.uniform(-math.pi, math.pi)
    noise = rng.uniform(-job.spawn.heading_noise_rad, job.spawn.heading_noise_rad)
    x = target.centroid_m[0] + distance * math.cos(bearing)
    y = target.centroid_m[1] + distance * math.sin(bearing)
    return float(x), float(y), math.remainder(bearing + math.pi + noise, 2 * math.pi)


def _draw_among(points: NDArray[np.float32], rng: np.random.Generator) -> tuple[float, float, float]:
    x, y = points[int(rng.integers(len(points)))]
    return float(x), float(y), float(rng.uniform(-math.pi, math.pi))


def _surveyed_points(job: Job, target: Target, place: LoadedScene) -> NDArray[np.float32]:
    if job.expert is ExpertName.PLANNER:
        return _points_within_reach(job, target, place)
    column = place.scene.info.targets.index(target)
    return place.scene.spawns[place.scene.spawn_sees[:, column] > 0]


def _points_within_reach(job: Job, target: Target, place: LoadedScene) -> NDArray[np.float32]:
    """Surveyed points from which the way along the floor is short enough to be driven within the step limit."""
    points = place.scene.spawns
    way = geodesic_field(place.grid, target, job.task.success_radius_m).metres
    is_short = place.grid.values_at(way, points, np.inf).astype(np.float64) <= job.planner.max_path_m
    is_outside = np.linalg.norm(points - np.asarray(target.centroid_m[:2]), axis=1) >= _CLOSEST_FAR_M
    return np.asarray(points[is_short & is_outside])


def _can_start(job: Job, target: Target, place: LoadedScene, x: float, y: float, yaw: float) -> bool:
    if not place.is_connected(x, y, yaw):
        return False
    is_planner = job.expert is ExpertName.PLANNER
    if is_planner and not pose_table(place.grid, job.planner.tight_margin_m).holds(x, y, yaw):
        return False
    if job.tier is Tier.FAR:
        return True  # its points were chosen by their way
    if not place.grid.has_sight((x, y), target):
        return False
    end = straight_end((x, y), target.centroid_m[:2], ARRIVAL_RADIUS_M)
    return is_planner or place.grid.is_line_free((x, y), end, job.spawn.approach_clearance_m)
