"""Samples the start pose of an attempt by tier on the occupancy grid, and tests it in physics (paper Sec. III-D).

Uses the attempt's random generator only. The part on the grid consists of pure functions. A prediction of the path of a
controller that drives straight helps to select starts; it does not predict how an episode ends.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from schemas.job import Job
from schemas.measure import Goal
from schemas.scene import Target
from schemas.start_survey import STEP_M, STEP_RAD
from schemas.support import portable
from schemas.support.numpy_types import Bools
from schemas.terms import TIER_RANGE_M, ExpertName, Screening, SuccessMeasure, Tier
from workers.geometry.grid import are_within
from workers.geometry.mask_estimate import MaskEstimate
from workers.geometry.pose import Pose
from workers.geometry.slew import Twist, slew
from workers.physics.world import World
from workers.planning import geodesic_field, geodesic_m, pose_table
from workers.sim.context import LoadedScene

_HZ = 20
"""Predicted poses per second; at full speed they are one cell of the grid apart."""
_LOOK_EVERY = 3
"""Number of poses between two evaluations of the mask, which take most of the time."""


def predict_path(
    start: tuple[float, float, float], goal: Goal, job: Job, estimate: MaskEstimate | None = None
) -> NDArray[np.float64]:
    """Returns the predicted poses (N, 3) x, y, yaw from `start` to the success region, metres and radians.

    Args:
        start: x, y in metres and yaw in radians of base_link, at rest.
        goal: goal of the episode.
        job: job, with gains, slew limits and the step limit.
        estimate: estimate of the mask of the target, for steering by its mask; `None` for steering by the centroid.
    """
    gains, robot = job.gains, job.robot
    x, y, yaw = start
    centre_x, centre_y = goal.centre_m
    twist = Twist(0.0, 0.0)
    poses = [start]
    pixels = column = 0.0
    for step in range(job.task.max_steps * _HZ // job.task.control_hz):
        distance = goal.distance(x, y)
        if distance <= goal.radius_m:
            break
        if estimate is not None and step % _LOOK_EVERY == 0:
            pixels, column = estimate.evaluate(x, y, yaw)
        error = (
            -column
            if pixels >= gains.min_mask_px
            else math.remainder(math.atan2(centre_y - y, centre_x - x) - yaw, 2 * math.pi)
        )
        turn = min(max(gains.yaw_gain * error, -robot.max_yaw_rate_rps), robot.max_yaw_rate_rps)
        twist = slew(twist, Twist(min(gains.speed_gain * distance, robot.max_speed_mps), turn), robot, 1.0 / _HZ)
        yaw += twist.w_rps / _HZ
        x += twist.v_mps * math.cos(yaw) / _HZ
        y += twist.v_mps * math.sin(yaw) / _HZ
        poses.append((x, y, yaw))
    return np.array(poses)


ARRIVAL_RADIUS_M = 0.97
"""Distance from the target at which the robot stops inside the success region, by the success measure, metres."""
_BEARINGS = 384
"""Number of bearings tested at one distance."""
_DISTANCE_STREAM = 1
"""Key of the random stream of the distances of an episode whose starts are drawn without a check for obstacles."""
_PREDICTIONS = 32
"""In the near and mid tiers, largest number of starts whose view is tested at each distance. For an expert that drives
straight, also the largest number of starts whose path is predicted, in all tiers; if none of these paths has the free
space `_PREDICTION_MARGIN_M`, the start of the path with the most free space is selected."""
_REJECTIONS = 256
"""Number of rejected views of otherwise valid starts after which the search for a start ends."""
_PROPOSALS = 96
"""Number of proposed starts that are tested if the target is drawn at the start."""
_PREDICTION_MARGIN_M = 0.10
"""Free space around the footprint along a predicted path, metres; with less, robots touch the obstacles they pass."""

Poses = NDArray[np.float64]
"""(N, 3) x, y in metres and yaw in radians, world frame."""
Start = tuple[float, float, float]
"""x, y in metres and yaw in radians of base_link, world frame."""


def draw_poses(
    job: Job,
    target: Target,
    scene: LoadedScene,
    rng: np.random.Generator,
    accepts: Callable[[Pose], bool] = lambda _pose: True,
) -> Iterator[Pose]:
    """Yields start poses that are free on the grid, at most `job.spawn.physics_draws` of them.

    In the near and mid tiers, the function draws a uniform distance, and then bearings at that distance until a pose
    is free; the heading is towards the target plus noise. If none of `_BEARINGS` bearings is free, it draws another
    distance. So obstacles reject bearings, not distances, and the distances have the distribution of the paper. In the
    far tier, the function draws a uniform heading and a surveyed floor point whose distance along the floor is within
    `job.spawn.far_floor_m`. For experts that drive straight, `job.spawn.screening` sets more conditions. The planner
    can start at any of these poses from which it sees its target (near and mid tiers) or its path is not too long (far
    tier). If the target is drawn at the start, the poses are drawn from those of the scene from which several objects
    could be the target.

    Args:
        job: job, with tier, expert and spawn settings.
        target: target to approach.
        scene: scene with its grid.
        rng: random generator of the attempt; consumed in a fixed order.
        accepts: further condition on a start, evaluated last. The sequence of candidates does not depend on it. The
            draw ends after the condition has rejected `_REJECTIONS` candidates.
    """
    z = scene.compiled.info.floor_height_m
    if job.choice is not None:
        yield from itertools.islice(_draw_exchangeable(job, target, scene, rng, accepts), job.spawn.physics_draws)
        return
    for _ in range(job.spawn.physics_draws):
        pose = _draw_on_grid(job, target, scene=scene, rng=rng, accepts=lambda start: accepts(Pose.planar(*start, z=z)))
        if pose is None:
            return
        yield Pose.planar(*pose, z=z)


def is_spawn_stable(world: World, pose: Pose, job: Job) -> bool:
    """Places the robot, simulates the warm-up steps, and returns whether it kept its scene.

    Design: docs/design/starts.md#in-physics.

    The paper's displacement test alone does not detect overlaps of a few centimetres, so a penetration test precedes
    it.
    """
    spawn = job.spawn
    world.place(pose.x, pose.y, pose.yaw)
    if world.deepest_penetration() > spawn.max_penetration_m:
        return False
    for _ in range(spawn.warmup_steps):
        world.step()
    after = world.pose()
    return math.hypot(after.x - pose.x, after.y - pose.y) <= spawn.max_displacement_m


def _draw_exchangeable(
    job: Job, target: Target, scene: LoadedScene, rng: np.random.Generator, accepts: Callable[[Pose], bool]
) -> Iterator[Pose]:
    """Yields starts from which several objects, one of them `target`, could be the target of the episode."""
    # Design: docs/design/starts.md#searched-starts.
    assert job.choice is not None
    assert job.start_view is not None
    among, least = job.choice.among, job.start_view.least_same_category + 1
    noise_rad = job.spawn.heading_noise_rad
    proposals = scene.exchange.starts(among, job.tier, least=least, heading_noise_rad=noise_rad, task=job.task)
    poses = proposals.of(among.index(target.instance_id)).poses
    if len(poses) == 0:
        return
    poses = poses[rng.integers(len(poses), size=_PROPOSALS)]
    poses = poses + rng.uniform(-0.5, 0.5, poses.shape) * (STEP_M, STEP_M, STEP_RAD)
    for x, y, yaw in poses[_can_start(job, target, scene, poses)].tolist():
        pose = Pose.planar(x, y, math.remainder(yaw, 2 * math.pi), z=scene.compiled.info.floor_height_m)
        if accepts(pose):
            yield pose


def _draw_on_grid(
    job: Job, target: Target, scene: LoadedScene, rng: np.random.Generator, accepts: Callable[[Start], bool]
) -> Start | None:
    fitting = _draw_fitting(job, target, scene=scene, rng=rng, accepts=accepts)
    first = next(fitting, None)
    if first is None or not _is_screened(job) or job.spawn.screening is not Screening.FORESEEN:
        return first
    # Design: docs/design/starts.md#predicted-drives.
    some = itertools.chain((first,), itertools.islice(fitting, _PREDICTIONS - 1))
    estimate = MaskEstimate(scene.compiled, target.instance_id, job.camera)
    best, most_m = first, -math.inf
    for start in some:
        room_m = _room_along_drive(job, target, scene=scene, start=start, estimate=estimate)
        if room_m >= _PREDICTION_MARGIN_M:
            return start
        if room_m > most_m:
            best, most_m = start, room_m
    return best


def _draw_fitting(
    job: Job, target: Target, scene: LoadedScene, rng: np.random.Generator, accepts: Callable[[Start], bool]
) -> Iterator[Start]:
    """Yields valid starts; in the near and mid tiers, only those at the first distance with a valid start."""
    surveyed = surveyed_points(job, target, scene) if job.tier is Tier.FAR else None
    if surveyed is not None and len(surveyed) == 0:
        return
    distances, rejected = _distance_stream(job, rng), 0
    for _ in range(job.spawn.grid_draws):
        if surveyed is None:
            poses = _draw_around(job, target, distances, rng)
        else:
            poses = draw_among(surveyed, job, target, rng)
        fits = np.flatnonzero(_can_start(job, target, scene, poses))[:_PREDICTIONS]
        before = rejected
        for x, y, yaw in poses[fits].tolist():
            if accepts((x, y, yaw)):
                yield x, y, yaw
            else:
                rejected += 1
        if rejected >= _REJECTIONS or (surveyed is None and rejected - before < len(fits)):
            return


def _distance_stream(job: Job, rng: np.random.Generator) -> np.random.Generator:
    """Returns the random generator of the start distances.

    If starts are drawn blindly, i.e. without a check for obstacles, all attempts at an episode share one stream of
    distances. Blind attempts from a large distance fail more often, so without a shared stream, the archived distances
    would be shorter than those of the tier (docs/design/starts.md#blind-starts-of-paper).
    """
    if job.expert is ExpertName.PLANNER or job.spawn.needs_free_line:
        return rng
    return np.random.default_rng(np.random.SeedSequence((job.root_seed, job.index), spawn_key=(_DISTANCE_STREAM,)))


def _draw_around(job: Job, target: Target, distances: np.random.Generator, rng: np.random.Generator) -> Poses:
    """Returns poses (N, 3) at one random distance, in random order."""
    distance = distances.uniform(*TIER_RANGE_M[job.tier])
    bearing = rng.uniform(-math.pi, math.pi, _BEARINGS)
    noise = rng.uniform(-job.spawn.heading_noise_rad, job.spawn.heading_noise_rad, _BEARINGS)
    yaw = bearing + math.pi + noise
    rays = np.stack([portable.cos(bearing), portable.sin(bearing)], axis=1)
    points = Goal.of(target, job.task).ring(rays, distance)
    return np.column_stack([points, portable.arctan2(portable.sin(yaw), portable.cos(yaw))])


def draw_among(points: NDArray[np.float32], job: Job, target: Target, rng: np.random.Generator) -> Poses:
    """Returns one pose with any heading, or with a heading that may show the target if the job requires this."""
    x, y = points[int(rng.integers(len(points)))].tolist()
    if job.start_view is None or not job.start_view.shows_target:
        return np.array([[x, y, rng.uniform(-math.pi, math.pi)]])
    within_rad = job.start_view.within_rad or math.radians(job.camera.fov_deg) / 2
    towards = math.atan2(target.centroid_m[1] - y, target.centroid_m[0] - x)
    return np.array([[x, y, math.remainder(towards + rng.uniform(-within_rad, within_rad), 2 * math.pi)]])


def _is_screened(job: Job) -> bool:
    """Returns whether starts need a free straight line."""
    return job.expert is not ExpertName.PLANNER and job.spawn.needs_free_line


def surveyed_points(job: Job, target: Target, scene: LoadedScene) -> NDArray[np.float32]:
    """Returns the surveyed points (N, 2) whose distance along the floor to the target is in the range of the tier."""
    points = _points_on_free_lines(job, target, scene) if _is_screened(job) else scene.compiled.spawns
    low, high = job.spawn.far_floor_m
    way = geodesic_field(scene.grid, target, job.task).metres
    floor_m = scene.grid.values_at(way, points, np.inf).astype(np.float64)
    longest = high - job.task.success_radius_m
    if job.expert is ExpertName.PLANNER:
        longest = min(longest, job.planner.max_path_m)
    # a distance of the field is up to 2.8 % longer than the shortest path, so `_is_far` checks the lower limit again
    return np.asarray(points[(floor_m >= low - job.task.success_radius_m) & (floor_m <= longest)])


def _points_on_free_lines(job: Job, target: Target, scene: LoadedScene) -> NDArray[np.float32]:
    if job.task.success is SuccessMeasure.CENTROID:
        column = scene.compiled.info.targets.index(target)
        return scene.compiled.spawns[scene.compiled.spawn_sees[:, column] > 0]
    points = scene.compiled.spawns[scene.grid.have_sight(scene.compiled.spawns, target)]
    return np.asarray(points[_is_way_free(job, target, scene, points.astype(np.float64))])


def _can_start(job: Job, target: Target, scene: LoadedScene, poses: Poses) -> Bools:
    """Returns whether an episode of the job may start at each of the poses (N, 3).

    Each test evaluates only the poses that passed all tests before it.
    """
    tests: list[Callable[[Poses], Bools]] = [
        lambda at: scene.grid.are_poses_free(at[:, 0], at[:, 1], at[:, 2], job.spawn.margin_m),
        lambda at: scene.are_connected(at[:, 0], at[:, 1], at[:, 2]),
        lambda at: ~are_within(at[:, :2], scene.taken),
    ]
    if job.expert is ExpertName.PLANNER:
        table = pose_table(scene.grid, job.planner.tight_margin_m)
        tests.append(lambda at: np.array([table.holds(scene.grid, *pose) for pose in at], bool))
    if job.tier is Tier.FAR:  # `surveyed_points` has tested free lines
        tests.append(lambda at: np.array([_is_far(job, target, scene, pose[:2]) for pose in at], bool))
    elif job.expert is ExpertName.PLANNER or job.spawn.screening is not Screening.NONE:
        tests.append(lambda at: scene.grid.have_sight(at[:, :2], target))
        if _is_screened(job):
            tests.append(lambda at: _is_way_free(job, target, scene, at[:, :2]))
    rest = np.arange(len(poses))
    for passes in tests:
        rest = rest[passes(poses[rest])]
    return np.isin(np.arange(len(poses)), rest)


def _is_far(job: Job, target: Target, scene: LoadedScene, xy: NDArray[np.float64]) -> bool:
    path_m = geodesic_m(scene.grid, xy, target, job.task)
    return path_m is not None and path_m + job.task.success_radius_m >= job.spawn.far_floor_m[0]


def _is_way_free(job: Job, target: Target, scene: LoadedScene, starts: NDArray[np.float64]) -> Bools:
    # experts that drive straight cannot pass corners, so many attempts with a blocked line would fail
    ends = Goal.of(target, job.task).approach(starts, ARRIVAL_RADIUS_M)
    return scene.grid.are_lines_free(starts, ends, job.spawn.approach_clearance_m)


def _room_along_drive(job: Job, target: Target, scene: LoadedScene, start: Start, estimate: MaskEstimate) -> float:
    """Returns the smallest free space around the footprint along the predicted path, metres."""
    drive = predict_path(start, Goal.of(target, job.task), job, estimate)
    return float(scene.grid.room_at_poses(drive[:, 0], drive[:, 1], drive[:, 2]).min())
