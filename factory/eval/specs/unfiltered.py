"""Creates specs with unfiltered start poses in the scenes of a dataset, whether or not an expert can reach the target.

Archived episodes contain only starts that their tier allows and from which the expert succeeded. These specs are not
selected in this way. The start view must still meet the conditions of the instruction. Renders the first view of each
start; runs no policies.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Mapping

import numpy as np

from coordinator.expansion.catalog import Catalog
from coordinator.expansion.draw import PlannedJob, expand, redraw, to_job
from coordinator.expansion.plan_file import shrink
from factory.dataset.reader import Dataset
from factory.eval.driving.simulator import Simulator, UnstableStart
from factory.eval.models.spec import EvalSettings, EvalSpec, SpecSet
from factory.eval.specs.from_dataset import LoadedScenes, categories_in_view
from factory.runs.scene_packages import find_package
from schemas.episode_spec import EpisodeSpec
from schemas.errors import UsageError, WorldError
from schemas.job import Job
from schemas.layouts import LayoutPlan
from schemas.measure import Goal, target_in_view
from schemas.plan import Plan
from schemas.scene import Target
from schemas.terms import TIER_RANGE_M, ExpertName, Split, Tier
from workers.geometry.grid import body_centre
from workers.geometry.pose import Pose
from workers.planning import geodesic_m
from workers.sim.aim import Choices, find_aim, is_view_clear, start_target
from workers.sim.context import LoadedScene, SimulationContext
from workers.sim.spawn import Start, draw_among

_DRAW_STREAM, _SEED_STREAM = 21, 22
_REDRAWS = 40

ProgressCallback = Callable[[int, int], None]


def unfiltered_specs(
    dataset: Dataset,
    splits: Collection[Split],
    episodes: int,
    seed: int,
    context: SimulationContext,
    tell: ProgressCallback = lambda _done, _total: None,
) -> SpecSet:
    """Returns newly drawn specs, in the split shares of the dataset's plan.

    A start pose must be collision-free, on the connected floor and stable in physics. The straight line to the target
    can be blocked, the path too long for the step limit, and the target out of view unless the instruction requires it.

    Args:
        dataset: Dataset with plan and scenes.
        splits: Splits, weighted by their shares in the plan.
        episodes: Number of episodes.
        seed: Root seed.
        context: Open scene renderer, used for the view at each start.
        tell: Progress callback.

    Raises:
        UsageError: No scene supports these splits.
        WorldError: No valid start pose was found for a target.
    """
    catalog = {name: find_package(dataset.root, name, sha256) for name, sha256 in dataset.meta.scenes.items()}
    plan = _plan(dataset.meta.plan, splits, episodes, seed)
    places = LoadedScenes(dataset.root)
    settings = EvalSettings.of(plan)
    specs: dict[int, EvalSpec] = {}
    planned = sorted(expand(plan, catalog), key=lambda job: (job.episode.scene, job.episode.target_id))
    with Simulator(context, settings) as simulator:
        for done, job in enumerate(planned, 1):
            scene = places.load(job.episode.scene, catalog[job.episode.scene].sha256)
            specs[job.index] = _spec(plan, catalog, planned=job, scene=scene, simulator=simulator, context=context)
            tell(done, len(planned))
    names = ", ".join(str(split) for split in splits)
    return SpecSet(
        source=f"unfiltered starts in the scenes of {dataset.meta.run}, splits {names}, seed {seed}",
        run=dataset.meta.run,
        settings=settings,
        specs=tuple(specs[index] for index in sorted(specs)),
    )


def _plan(plan: Plan, splits: Collection[Split], episodes: int, seed: int) -> Plan:
    """Returns the plan with these splits only, and with the planner, so every reachable target can be drawn."""
    scenes = []
    for scene in plan.parts:
        is_unseen = isinstance(scene, LayoutPlan) and scene.is_unseen
        possible = [
            split
            for split in splits
            if split.is_unseen_scene is is_unseen and (scene.categories.held_out or not split.is_held_out)
        ]
        if possible:
            shares = _shares(plan.splits_of(scene), possible)
            fixed = scene.as_scene() if isinstance(scene, LayoutPlan) else scene
            scenes.append(fixed.model_copy(update={"splits": shares}))
    if not scenes:
        wanted = ", ".join(splits)
        raise UsageError(
            f"no scene of {plan.run} has held-out categories or unseen layouts, so {wanted} has no episodes"
        )
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


def _spec(
    plan: Plan,
    catalog: Catalog,
    planned: PlannedJob,
    scene: LoadedScene,
    simulator: Simulator,
    context: SimulationContext,
) -> EvalSpec:
    for _ in range(_REDRAWS):
        job = to_job(plan, catalog, planned, attempt=1)
        for pose in _draw_poses(job, scene, context):
            try:
                view = simulator.reset(_described(job, pose), scene)
            except UnstableStart:
                continue
            choices = Choices(job, scene.compiled.info, context.renderer)
            if not is_view_clear(job, scene.compiled.info, context.renderer, view.pose, choices):
                continue
            aim = find_aim(job, scene, context.renderer, view.pose, choices)
            if aim is None:
                continue
            drawn, target, instruction = _described(aim.job, pose), aim.target, aim.instruction
            if aim.choices:  # the target was drawn: measure the distance to it
                view = simulator.reset(drawn, scene)
            if instruction is not None:
                drawn = drawn.model_copy(
                    update={"instruction": instruction.text, "template_id": instruction.template_id}
                )
            instances, pixels = scene.compiled.info.instances, plan.gains.min_mask_px
            way = (
                None if job.is_false_premise else geodesic_m(scene.grid, (view.pose.x, view.pose.y), target, plan.task)
            )
            return drawn.model_copy(
                update={
                    "spawn_dist_m": view.distance_m,
                    "geodesic_m": way,
                    "categories_in_view": categories_in_view(view.frame.ids, instances, pixels),
                    "is_target_in_view": target_in_view(view.frame.ids, target.instance_id, pixels),
                }
            )
        planned = redraw(plan, catalog, planned)
    raise WorldError(
        f"found no free start pose at which the instruction is clear for {job.target_id} and {_REDRAWS} other targets "
        f"in scene {job.scene}, tier {job.tier}; exclude the split, or change the scene"
    )


def _described(job: Job, pose: Start) -> EvalSpec:
    seed = np.random.SeedSequence((job.root_seed, _SEED_STREAM, job.index)).generate_state(1)[0]
    return EvalSpec(
        spec_id=f"un_{job.index:06d}",
        **dict(EpisodeSpec.of(job)),
        scene_sha256=job.scene_sha256,
        seed=int(seed),
        spawn_pose=pose,
        spawn_source="drawn",
        spawn_dist_m=0.0,
        geodesic_m=None,
        categories_in_view=(),
        is_target_in_view=False,
    )


def _draw_poses(job: Job, scene: LoadedScene, context: SimulationContext) -> Iterator[Start]:
    """Yields free poses on the connected floor whose view meets the conditions of the instruction.

    Yields at most `physics_draws` poses. An attempt of data collection tests the same number in the simulation.
    """
    context.renderer.load(scene.compiled, job.camera)
    rng = np.random.default_rng(np.random.SeedSequence((job.root_seed, _DRAW_STREAM, job.index, job.draw)))
    target = start_target(job, scene.compiled.info)
    left, z = job.spawn.physics_draws, scene.compiled.info.floor_height_m
    for _ in range(job.spawn.grid_draws):
        x, y, yaw = _draw(job, target, scene, rng)
        is_on_floor = bool(scene.grid.values_at(scene.compiled.reachable, body_centre(x, y, yaw), 0))
        if not (is_on_floor and scene.grid.is_pose_free(x, y, yaw, job.spawn.margin_m)):
            continue
        # without this test, "the chair in front of you" could be behind the robot
        if is_view_clear(job, scene.compiled.info, context.renderer, Pose.planar(x, y, yaw, z=z)):
            yield x, y, yaw
            left -= 1
            if left == 0:
                return


def _draw(job: Job, target: Target, scene: LoadedScene, rng: np.random.Generator) -> Start:
    """Returns a random pose of the tier, drawn as in the paper (Sec. III-D), without any check."""
    if job.tier is Tier.FAR:
        x, y, yaw = draw_among(scene.compiled.spawns, job, target, rng)[0].tolist()
        return x, y, yaw
    distance, bearing = rng.uniform(*TIER_RANGE_M[job.tier]), rng.uniform(-math.pi, math.pi)
    noise = rng.uniform(-job.spawn.heading_noise_rad, job.spawn.heading_noise_rad)
    ray = np.array([[math.cos(bearing), math.sin(bearing)]])
    x, y = Goal.of(target, job.task).ring(ray, distance)[0]
    return float(x), float(y), math.remainder(bearing + math.pi + noise, 2 * math.pi)
