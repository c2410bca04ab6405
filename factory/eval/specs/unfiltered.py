"""Creates specs with unfiltered start poses in the scenes of a dataset, whether or not an expert can reach the target.

Archived episodes contain only starts that their tier allows and from which the expert succeeded; these specs do not
(field notes, point 25). Renders the first view of each start; runs no policies.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Mapping

import numpy as np

from coordinator.expansion.catalog import Catalog
from coordinator.expansion.draw import PlannedJob, expand, redraw
from coordinator.expansion.file import shrink
from factory.dataset.reader import Dataset
from factory.eval.driving.simulator import NoFirmStand, Simulator
from factory.eval.models.spec import EvalSettings, EvalSpec, SpecSet
from factory.eval.specs.from_dataset import Places, categories_in_view
from factory.runs.catalog import find_package
from schemas.errors import UsageError, WorldError
from schemas.measure import Goal
from schemas.plan import Plan
from schemas.scene import Target
from schemas.terms import TIER_RANGE_M, ExpertName, Split, Tier
from workers.geometry.grid import body_centre
from workers.planning import geodesic_m
from workers.sim.scene_renderer import LoadedScene, SceneRenderer

_DRAW_STREAM, _SEED_STREAM = 21, 22
_REDRAWS = 40

Pose = tuple[float, float, float]
ProgressCallback = Callable[[int, int], None]


def unfiltered_specs(
    dataset: Dataset,
    splits: Collection[Split],
    episodes: int,
    seed: int,
    stage: SceneRenderer,
    tell: ProgressCallback = lambda _done, _total: None,
) -> SpecSet:
    """Returns newly drawn specs, in the split shares of the dataset's plan.

    A start pose must be collision-free, on the connected floor and stable in physics. The straight line to the target
    can be blocked, the target out of view, and the path too long for the step limit.

    Args:
        dataset: Dataset with plan and scenes.
        splits: Splits, weighted by their shares in the plan.
        episodes: Number of episodes.
        seed: Root seed.
        stage: Open scene renderer, used for the view at each start.
        tell: Progress callback.

    Raises:
        UsageError: No scene supports these splits.
        WorldError: No valid start pose was found for a target.
    """
    catalog = {name: find_package(dataset.root, name, sha256) for name, sha256 in dataset.meta.scenes.items()}
    plan = _plan(dataset.meta.plan, splits, episodes, seed)
    places = Places(dataset.root)
    settings = EvalSettings.of(plan)
    specs: dict[int, EvalSpec] = {}
    planned = sorted(expand(plan, catalog), key=lambda job: (job.episode.scene, job.episode.target_id))
    with Simulator(stage, settings) as simulator:
        for done, job in enumerate(planned, 1):
            place = places.load(job.episode.scene, catalog[job.episode.scene].sha256)
            specs[job.index] = _spec(plan, catalog, job, place, simulator)
            tell(done, len(planned))
    names = ", ".join(str(split) for split in splits)
    return SpecSet(
        source=f"unfiltered starts in the scenes of {dataset.meta.run}, splits {names}, seed {seed}",
        run=dataset.meta.run,
        settings=settings,
        specs=tuple(specs[index] for index in sorted(specs)),
    )


def _plan(plan: Plan, splits: Collection[Split], episodes: int, seed: int) -> Plan:
    """Returns the plan with these splits only, which draws from all reachable targets, not only those of the expert."""
    scenes = []
    for scene in plan.scenes:
        possible = [split for split in splits if split is not Split.TEST_OOD_OBJ or scene.categories.held_out]
        if possible:
            shares = _shares(plan.splits_of(scene), possible)
            scenes.append(scene.model_copy(update={"splits": shares}))
    if not scenes:
        raise UsageError(f"no scene of {plan.run} has held-out categories, so test_ood_obj has no episodes")
    splits_in_force = scenes[0].splits
    changed = plan.model_copy(update={"scenes": tuple(scenes), "splits": splits_in_force, "expert": ExpertName.PLANNER})
    return shrink(changed, episodes=episodes, seed=seed)


def _shares(planned: Mapping[Split, float], splits: Collection[Split]) -> dict[Split, float]:
    """Returns the normalised shares of some splits; equal shares if the plan has none of them."""
    shares = {split: planned.get(split, 0.0) for split in splits}
    total = sum(shares.values())
    if total <= 0:
        return dict.fromkeys(splits, 1.0 / len(splits))
    return {split: share / total for split, share in shares.items()}


def _spec(plan: Plan, catalog: Catalog, job: PlannedJob, place: LoadedScene, simulator: Simulator) -> EvalSpec:
    for _ in range(_REDRAWS):
        target = place.scene.info.target(job.episode.target_id)
        for pose in _draw_poses(plan, job, target, place):
            drawn = _described(plan, catalog, job, pose)
            try:
                view = simulator.reset(drawn, place)
            except NoFirmStand:
                continue
            instances, pixels = place.scene.info.instances, plan.gains.min_mask_px
            way = geodesic_m(place.grid, (view.pose.x, view.pose.y), target, plan.task)
            return drawn.model_copy(
                update={
                    "spawn_dist_m": view.distance_m,
                    "geodesic_m": way,
                    "categories_in_view": categories_in_view(view.frame.ids, instances, pixels),
                    "is_target_in_view": int(np.count_nonzero(view.frame.ids == target.instance_id)) >= pixels,
                }
            )
        job = redraw(plan, catalog, job)
    raise WorldError(
        f"no free start pose for {job.episode.target_id} and {_REDRAWS} other targets in scene {job.episode.scene}, "
        f"tier {job.episode.tier}; exclude the split, or change the scene"
    )


def _described(plan: Plan, catalog: Catalog, job: PlannedJob, pose: Pose) -> EvalSpec:
    seed = np.random.SeedSequence((plan.seed, _SEED_STREAM, job.index)).generate_state(1)[0]
    return EvalSpec(
        spec_id=f"un_{job.index:06d}",
        **dict(job.episode),
        scene_sha256=catalog[job.episode.scene].sha256,
        seed=int(seed),
        spawn_pose=pose,
        spawn_source="drawn",
        spawn_dist_m=0.0,
        geodesic_m=None,
        categories_in_view=(),
        is_target_in_view=False,
    )


def _draw_poses(plan: Plan, job: PlannedJob, target: Target, place: LoadedScene) -> Iterator[Pose]:
    """Yields free poses on the connected floor, at most as many as an attempt tests in physics."""
    rng = np.random.default_rng(np.random.SeedSequence((plan.seed, _DRAW_STREAM, job.index, job.draw)))
    left = plan.spawn.physics_draws
    for _ in range(plan.spawn.grid_draws):
        x, y, yaw = _draw(plan, job, target, place, rng)
        is_on_floor = bool(place.grid.values_at(place.scene.reachable, body_centre(x, y, yaw), 0))
        if is_on_floor and place.grid.is_pose_free(x, y, yaw, plan.spawn.margin_m):
            yield x, y, yaw
            left -= 1
            if left == 0:
                return


def _draw(plan: Plan, job: PlannedJob, target: Target, place: LoadedScene, rng: np.random.Generator) -> Pose:
    """Returns a random pose of the tier, drawn as in the paper (Sec. III-D), without any check."""
    if job.episode.tier is Tier.FAR:
        x, y = place.scene.spawns[int(rng.integers(len(place.scene.spawns)))]
        return float(x), float(y), float(rng.uniform(-math.pi, math.pi))
    distance, bearing = rng.uniform(*TIER_RANGE_M[job.episode.tier]), rng.uniform(-math.pi, math.pi)
    noise = rng.uniform(-plan.spawn.heading_noise_rad, plan.spawn.heading_noise_rad)
    ray = np.array([[math.cos(bearing), math.sin(bearing)]])
    x, y = Goal.of(target, plan.task).ring(ray, distance)[0]
    return float(x), float(y), math.remainder(bearing + math.pi + noise, 2 * math.pi)
