"""Expands a plan into jobs: exact quotas of scene x tier x split, then category, target and template per episode.

The result depends on the plan and the compiled scenes only, not on the machine or the order of the work.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence, Set
from dataclasses import dataclass
from functools import lru_cache
from typing import TypeVar

import numpy as np

from coordinator.expansion.apportion import least_used
from coordinator.expansion.catalog import Catalog, SceneEntry
from coordinator.expansion.cells import Cell
from coordinator.expansion.level import category_quotas
from coordinator.expansion.scene_cells import SceneCells, categories_of, each_scene, scene_cells
from schemas.config import DemonstrationConfig
from schemas.episode_spec import EpisodeSpec
from schemas.errors import InvalidPlan
from schemas.instruction.language import instruction, says_in_front
from schemas.instruction.referents import referents, referents_of
from schemas.instruction.start_view import IN_FRONT_RAD, StartView
from schemas.job import Job
from schemas.language.file import LanguageSpec
from schemas.plan import Plan, ScenePlan
from schemas.scene import SceneInfo
from schemas.terms import Recording, Split, SuccessMeasure, Tier
from schemas.view import ViewSettings

Option = TypeVar("Option")

_EXPAND_STREAM, _REDRAW_STREAM, _RANK_STREAM = 1, 2, 4
_SAME_CATEGORY_DRAWS = 4
"""Number of redraws that keep the category; later redraws use all targets of the cell."""
_SHARED_SPECS = 1 << 14
"""Size of the cache of specs: a plan of millions of episodes repeats a few thousand specs."""


@dataclass(frozen=True)
class PlannedJob:
    """One draw of one episode of the plan."""

    index: int
    """Episode number, from 1."""
    draw: int
    episode: EpisodeSpec
    """Content of the episode; equal jobs share one object."""


def expand(plan: Plan, catalog: Catalog) -> tuple[PlannedJob, ...]:
    """Returns draw 0 of every episode, ordered by episode number (from 1).

    Cells of scene x tier x split have their exact Webster quota. Within a scene, targets and templates are sampled
    evenly. With `plan.balance == "categories"` the category is sampled first; with `categories_overall`, each cell has
    an exact quota of each category, which makes the categories of the whole plan as even as its scenes permit.

    Raises:
        InvalidPlan: a cell has no target that its tier can reach; the error lists every such cell.
    """
    scenes = tuple(each_scene(plan, catalog))
    _require_possible(plan, scenes)
    quotas = category_quotas(scenes) if plan.balance == "categories_overall" else {}
    jobs: list[PlannedJob] = []
    templates: Counter[str] = Counter()
    for number, scene in enumerate(scenes):
        rng = np.random.default_rng(np.random.SeedSequence((plan.seed, _EXPAND_STREAM, number)))
        jobs.extend(_expand_scene(scene, rng, len(jobs) + 1, templates, quotas.get(scene.scene.name, {})))
    return tuple(jobs)


def require_possible(plan: Plan, catalog: Catalog) -> None:
    """Checks that every cell of a plan has a target; `expand` checks it too.

    Raises:
        InvalidPlan: a cell has no target that its tier can reach; the error lists every such cell.
    """
    _require_possible(plan, tuple(each_scene(plan, catalog)))


def find_impossible(plan: Plan, catalog: Catalog) -> list[str]:
    """Returns a line for each scene that lacks categories and for each cell that stays without a target otherwise."""
    return _find_impossible(tuple(each_scene(plan, catalog)))


def _require_possible(plan: Plan, scenes: Sequence[SceneCells]) -> None:
    mistakes = _find_impossible(scenes)
    if mistakes:
        raise InvalidPlan(f"plan {plan.name!r} requires what its scenes do not have", mistakes)


def _find_impossible(scenes: Sequence[SceneCells]) -> list[str]:
    return [line for number, scene in enumerate(scenes) for line in _impossible_in(number, scene)]


def _impossible_in(number: int, cells: SceneCells) -> Iterator[str]:
    scene, entry = cells.scene, cells.entry
    success = cells.plan.task.success
    if success is SuccessMeasure.SURFACE and not entry.info.has_footprints:
        yield (
            f"scenes[{number}] {scene.name}: its package is of an older version and has no footprints of targets, "
            'which task.success = "surface" needs; create it again with `factory scene build` or `factory scene '
            'import`, or set task.success = "centroid"'
        )
        return
    present = {target.category for target in entry.info.targets if target.is_reachable(success)}
    named = {split: set(categories_of(scene, split)) for split, _ in cells.quota}
    if any(categories - present for categories in named.values()):
        yield f"scenes[{number}] {scene.name}: {_absent_message(scene, entry, present)}"
    ambiguous = {name for categories in named.values() for name in categories & present} - cells.present
    if ambiguous:
        yield f"scenes[{number}] {scene.name}: {_ambiguous_message(cells, ambiguous)}"
    for (split, tier), count in cells.quota.items():
        if named[split] & cells.present and not cells.pool(split, tier):
            yield (
                f"scenes[{number}] {scene.name}: cell {split} / {tier} ({count} episodes) has no target that the "
                f"{cells.plan.expert} expert could start for; set tiers.{tier} or splits.{split} of the scene to 0, or "
                "change the scene"
            )


def _absent_message(scene: ScenePlan, entry: SceneEntry, present: Set[str]) -> str:
    absent = [[name for name in names if name not in present] for names in scene.categories]
    missing = [
        f"no reachable {', '.join(map(repr, names))} ({key})"
        for key, names in zip(("seen", "held_out"), absent, strict=True)
        if names
    ]
    shown = {one.category for one in entry.info.instances} & {name for names in absent for name in names}
    blocked = f"; present but not reachable: {', '.join(sorted(filter(None, shown)))}" if shown else ""
    remedy = "remove the missing categories from seen and held_out, or change the scene"
    if scene.file is not None:
        remedy += ", its rules or its list of targets"
    return f"{', '.join(missing)}; reachable there: {', '.join(sorted(present)) or 'none'}{blocked}; {remedy}"


def _ambiguous_message(cells: SceneCells, ambiguous: Set[str]) -> str:
    if cells.plan.language is not None:
        return (
            f"language needs {cells.plan.language.least_others} other objects of the target's category, and "
            f"{', '.join(sorted(ambiguous))} has fewer; categories with enough there: "
            f"{', '.join(sorted(cells.present)) or 'none'}; remove the others from seen and held_out, or reduce "
            "language.same_category and language.in_view"
        )
    unique = ", ".join(cells.wording.unique)
    return (
        f'instructions.unique is "scene", but no instruction fits only one {" or ".join(sorted(ambiguous))}; '
        f"unique there: {unique or 'nothing'}; remove the other categories from seen and held_out, or set "
        'instructions.unique to "view", or list them in `ambiguous` of the scene'
    )


def _expand_scene(
    cells: SceneCells,
    rng: np.random.Generator,
    first_index: int,
    templates: Counter[str],
    quotas: Mapping[Cell, Counter[str]],
) -> Iterator[PlannedJob]:
    """Yields draw 0 of a scene's episodes, the cells in random order; `templates` counts over all scenes."""
    plan, wording = cells.plan, cells.wording
    decks = {cell: [str(name) for name in rng.permutation(list(quota.elements()))] for cell, quota in quotas.items()}
    slots = [cell for cell, count in cells.quota.items() for _ in range(count)]
    pools = {cell: cells.pool(*cell) for cell in cells.quota}
    categories: Counter[str] = Counter()
    targets: Counter[str] = Counter()
    for index, slot in enumerate(rng.permutation(len(slots)), first_index):
        split, tier = slots[int(slot)]
        options = pools[split, tier]
        if plan.balance != "instances":
            names = sorted({target.category for target in options})
            category = decks[split, tier].pop() if decks else least_used(names, categories, rng)
            options = tuple(target for target in options if target.category == category)
        target_id = least_used([target.target_id for target in options], targets, rng)
        target = next(option for option in options if option.target_id == target_id)
        colour = wording.colour_of(target)
        template_id = least_used(wording.templates(split, target), templates, rng)
        episode = _episode(cells.scene.name, tier, split, target.category, target.target_id, colour, template_id)
        yield PlannedJob(index, 0, episode)


def redraw(plan: Plan, catalog: Catalog, planned: PlannedJob) -> PlannedJob:
    """Returns the next draw of the same cell, after the attempts at the previous target failed.

    The first redraws keep the category; later redraws use all targets of the cell. With `categories_overall`, half of
    all draws keep the category. The template changes if the target cannot. The result depends on plan, scene, index and
    draw only, so that it does not depend on which worker failed or when.
    """
    draw, former = planned.draw + 1, planned.episode
    rng = np.random.default_rng(np.random.SeedSequence((plan.seed, _REDRAW_STREAM, planned.index, draw)))
    scene = next(scene for scene in plan.scenes if scene.name == former.scene)
    cells = scene_cells(plan, scene, catalog[scene.name])
    options = cells.pool(former.split, former.tier)
    same_category = tuple(target for target in options if target.category == former.category)
    if plan.balance == "categories_overall" and draw <= plan.budget.draws // 2:
        options = same_category or options
    elif draw > _SAME_CATEGORY_DRAWS:
        same_category = ()
    fresh = [target for target in same_category or options if target.target_id != former.target_id]
    target = _draw(fresh or options, rng)
    colour, templates = cells.wording.colour_of(target), cells.wording.templates(former.split, target)
    if former.template_id not in templates:
        template_id = _draw(templates, rng)
    elif fresh:
        template_id = former.template_id
    else:  # another template, so that this draw can succeed: one with a colour may fit the target alone
        template_id = _draw([each for each in templates if each != former.template_id] or templates, rng)
    words = target.category, target.target_id, colour, template_id
    return PlannedJob(planned.index, draw, _episode(scene.name, former.tier, former.split, *words))


def to_job(plan: Plan, catalog: Catalog, planned: PlannedJob, attempt: int) -> Job:
    """Returns the job of one attempt at a planned draw."""
    entry = catalog[planned.episode.scene]
    return Job(
        **dict(planned.episode),
        run=plan.run,
        plan_digest=plan.digest,
        root_seed=plan.seed,
        index=planned.index,
        draw=planned.draw,
        attempt=attempt,
        scene_sha256=entry.sha256,
        scene_bytes=entry.size,
        expert=plan.expert,
        task=plan.task,
        robot=plan.robot,
        camera=plan.camera,
        spawn=plan.spawn_of(planned.episode.scene),
        gains=plan.gains,
        planner=plan.planner,
        record=plan.record,
        view=_view(plan, entry),
        start_view=_start_view(plan, entry.info, planned),
        demonstration=_demonstration(plan, planned.episode),
        language=plan.language,
    )


def _view(plan: Plan, entry: SceneEntry) -> ViewSettings:
    """Returns what the episode is rendered with; the default for a recording of states."""
    if plan.record is not Recording.FRAMES:
        return ViewSettings()
    return plan.view if entry.light is None else plan.view.model_copy(update={"light": entry.light_file})


def _demonstration(plan: Plan, episode: EpisodeSpec) -> DemonstrationConfig:
    """Returns the requirements on a demonstration; one that stops at a false premise has no target to show."""
    wanted = plan.demonstration
    return wanted.model_copy(update={"target_in_view": False}) if episode.is_false_premise else wanted


def _start_view(plan: Plan, info: SceneInfo, planned: PlannedJob) -> StartView | None:
    """Returns the conditions on the start of an episode; `None` if there are none."""
    episode = planned.episode
    if plan.language is not None:
        return _language_view(plan, plan.language, info, planned)
    within_rad = IN_FRONT_RAD if says_in_front(episode.template_id) else None
    if plan.instructions.unique == "off":
        return None if within_rad is None else StartView(within_rad=within_rad)
    target = {info.target(episode.target_id).instance_id}
    alike = referents(info, episode.category) - target
    is_exempt = any(scene.name == episode.scene and episode.category in scene.ambiguous for scene in plan.scenes)
    rivals = frozenset() if is_exempt else referents_of(episode, info) - target
    return StartView(within_rad=within_rad, rivals=tuple(sorted(rivals)), alike=tuple(sorted(alike)))


def _language_view(plan: Plan, language: LanguageSpec, info: SceneInfo, planned: PlannedJob) -> StartView | None:
    """Returns the conditions of a language block on the start of an episode; `None` if there are none."""
    if not language.in_view:
        return None
    episode, ranks = planned.episode, None
    if language.balanced:  # the same in all draws of an episode, so that ranks that are hard to find stay as frequent
        rng = np.random.default_rng(np.random.SeedSequence((plan.seed, _RANK_STREAM, planned.index)))
        ranks = (float(rng.random()), float(rng.random()))
    alike = referents(info, episode.category) - {info.target(episode.target_id).instance_id}
    return StartView(alike=tuple(sorted(alike)), least_alike=language.in_view, ranks=ranks)


def _draw(options: Sequence[Option], rng: np.random.Generator) -> Option:
    return options[int(rng.integers(len(options)))]


@lru_cache(maxsize=_SHARED_SPECS)
def _episode(
    scene: str, tier: Tier, split: Split, category: str, target_id: str, colour: str, template_id: str
) -> EpisodeSpec:
    return EpisodeSpec(
        scene=scene,
        tier=tier,
        split=split,
        category=category,
        target_id=target_id,
        colour=colour,
        template_id=template_id,
        instruction=instruction(template_id, category, colour),
    )
