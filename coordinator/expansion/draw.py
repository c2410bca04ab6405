"""Expands a plan into jobs: exact quotas of scene x tier x split, then category, target and template per episode.

The result depends on the plan and the compiled scenes only, not on the machine or the order of the work. For an
evaluation, the jobs are its tasks, which this module does not interpret.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import TypeVar

import numpy as np

from coordinator.expansion.balance import category_quotas, layout_categories
from coordinator.expansion.catalog import Catalog, SceneEntry
from coordinator.expansion.cells import Cell
from coordinator.expansion.possible import raise_if_impossible
from coordinator.expansion.scene_cells import SceneCells, each_scene, scene_cells
from schemas.config import DemonstrationConfig
from schemas.episode_spec import EpisodeSpec
from schemas.instruction.referents import referents, referents_of
from schemas.instruction.start_view import IN_FRONT_RAD, StartView, TargetChoice
from schemas.instruction.templates import instruction, says_in_front
from schemas.job import Job
from schemas.language.language_file import LanguageSpec
from schemas.layouts import LayoutPlan
from schemas.plan import Plan
from schemas.protocol.messages import EvalPayload, PolicyWait
from schemas.scene import SceneInfo
from schemas.support.apportion import least_used
from schemas.terms import Recording, Split, Tier
from schemas.view import ViewSettings


@dataclass(frozen=True)
class EvalJobs:
    """Jobs of an evaluation run; its plan defines the scenes and the settings only."""

    planned: tuple[PlannedJob, ...]
    """Jobs of a new ledger."""
    find: Callable[[int], EvalPayload]
    """Function that returns the payload of a job by its index."""
    files: Mapping[str, Path] = field(default_factory=dict)
    """Attached files by SHA-256."""
    on_wait: Callable[[int, PolicyWait], None] = lambda _index, _wait: None
    """Callback with the index of a job that waits long for its policy; called in the thread of the ledger for each
    heartbeat, so it must not block."""


Option = TypeVar("Option")

_EXPAND_STREAM, _REDRAW_STREAM, _RANK_STREAM = 1, 2, 4
_SAME_CATEGORY_DRAWS = 4
"""Number of redraws that keep the category of an episode; later redraws use all targets of the cell."""
_SHARED_SPECS = 1 << 14
"""Maximum number of cached `EpisodeSpec` objects. A plan of millions of episodes repeats a few thousand of them."""


@dataclass(frozen=True)
class PlannedJob:
    """One draw of one episode of the plan."""

    index: int
    """Episode number, from 1."""
    draw: int
    episode: EpisodeSpec
    """Content of the episode; draws with equal content share one object."""


def expand(plan: Plan, catalog: Catalog) -> tuple[PlannedJob, ...]:
    """Returns draw 0 of every episode, ordered by episode number (from 1); see `expand_each`."""
    return tuple(expand_each(plan, catalog))


def expand_each(plan: Plan, catalog: Catalog) -> Iterator[PlannedJob]:
    """Yields draw 0 of every episode, ordered by episode number (from 1).

    Cells of scene x tier x split have their exact Webster quota. Within a scene, targets and templates are sampled
    evenly. With `plan.balance == "categories"` the category is sampled first; with `categories_overall`, each cell has
    an exact quota of each category, which makes the categories of the whole plan as even as its scenes permit.
    The draws of a layout depend on the plan and on the package of the layout only, so memory holds one layout at a
    time.
    The layouts that the catalog lacks are omitted.

    Raises:
        InvalidPlan: a cell has no target that its tier can reach; the error lists every such cell of the fixed scenes,
            or of the first such layout.
    """
    fixed = tuple(cells for cells in each_scene(plan, catalog) if not isinstance(cells.scene, LayoutPlan))
    raise_if_impossible(plan, fixed)
    quotas = category_quotas(fixed) if plan.balance == "categories_overall" else {}
    templates: Counter[str] = Counter()
    first_index, scenes = 1, iter(fixed)
    for number, part in enumerate(plan.parts):
        if isinstance(part, LayoutPlan):
            if part.name in catalog:
                yield from expand_layout(plan, number, first_index, catalog[part.name])
        else:
            rng = np.random.default_rng(np.random.SeedSequence((plan.seed, _EXPAND_STREAM, number)))
            yield from _expand_scene(
                next(scenes), rng, first_index=first_index, templates=templates, quotas=quotas.get(part.name, {})
            )
        first_index += part.episodes


def expand_layout(plan: Plan, number: int, first_index: int, entry: SceneEntry) -> Iterator[PlannedJob]:
    """Yields draw 0 of the episodes of one layout.

    Args:
        plan: plan of the run.
        number: place of the layout in `plan.parts`.
        first_index: number of its first episode.
        entry: its package.

    Raises:
        InvalidPlan: a cell of the layout has no target.
    """
    cells = scene_cells(plan, plan.parts[number], entry)
    raise_if_impossible(plan, (cells,))
    rng = np.random.default_rng(np.random.SeedSequence((plan.seed, _EXPAND_STREAM, number)))
    yield from _expand_scene(
        cells, rng, first_index=first_index, templates=Counter(), quotas=layout_categories(plan, cells.scene)
    )


def _expand_scene(
    cells: SceneCells,
    rng: np.random.Generator,
    first_index: int,
    templates: Counter[str],
    quotas: Mapping[Cell, Counter[str]],
) -> Iterator[PlannedJob]:
    """Yields draw 0 of a scene's episodes, with the cells in random order.

    Counts the episodes of each template in `templates`, which all scenes of the plan share.
    """
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
            wanted = decks[split, tier].pop() if decks else None
            category = wanted if wanted in names else least_used(names, categories, rng)
            options = tuple(target for target in options if target.category == category)
        target_id = least_used([target.target_id for target in options], targets, rng)
        target = next(option for option in options if option.target_id == target_id)
        colour = wording.colour_of(target)
        template_id = least_used(cells.templates(split, tier, target), templates, rng)
        episode = _episode(
            cells.scene.name,
            tier,
            split=split,
            category=target.category,
            target_id=target.target_id,
            colour=colour,
            template_id=template_id,
        )
        yield PlannedJob(index, 0, episode)


def redraw(plan: Plan, catalog: Catalog, planned: PlannedJob) -> PlannedJob:
    """Returns the next draw of the same cell, after the attempts at the previous target failed.

    The first redraws keep the category; later redraws use all targets of the cell. With `categories_overall`, half of
    all draws keep the category. If no other target exists, the template changes. The result depends on plan, scene,
    index and draw only, so it does not depend on which worker failed or when.
    """
    draw, former = planned.draw + 1, planned.episode
    rng = np.random.default_rng(np.random.SeedSequence((plan.seed, _REDRAW_STREAM, planned.index, draw)))
    cells = scene_cells(plan, plan.part(former.scene), catalog[former.scene])
    options = cells.pool(former.split, former.tier)
    same_category = tuple(target for target in options if target.category == former.category)
    if plan.balance == "categories_overall" and draw <= plan.budget.draws // 2:
        options = same_category or options
    elif draw > _SAME_CATEGORY_DRAWS:
        same_category = ()
    fresh = [target for target in same_category or options if target.target_id != former.target_id]
    target = _draw(fresh or options, rng)
    colour, templates = cells.wording.colour_of(target), cells.templates(former.split, former.tier, target)
    if former.template_id not in templates:
        template_id = _draw(templates, rng)
    elif fresh:
        template_id = former.template_id
    else:  # the target is the same: another template, e.g. with a colour, may succeed
        template_id = _draw([each for each in templates if each != former.template_id] or templates, rng)
    words = target.category, target.target_id, colour, template_id
    return PlannedJob(planned.index, draw, _episode(former.scene, former.tier, former.split, *words))


def to_job(plan: Plan, catalog: Catalog, planned: PlannedJob, attempt: int) -> Job:
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
        start_view=_start_view(plan, entry, planned),
        demonstration=_demonstration(plan, planned.episode),
        correction=plan.correction,
        language=None if plan.language is None else plan.language.of_episode(planned.index),
    )


def _view(plan: Plan, entry: SceneEntry) -> ViewSettings:
    """Returns the view settings of the job; a recording of states has the default settings."""
    if plan.record is not Recording.FRAMES:
        return ViewSettings()
    return plan.view if entry.light is None else plan.view.model_copy(update={"light": entry.light_file})


def _demonstration(plan: Plan, episode: EpisodeSpec) -> DemonstrationConfig:
    """Returns the requirements on a demonstration; with a false premise, the last frame need not show the target."""
    wanted = plan.demonstration
    return wanted.model_copy(update={"target_in_view": False}) if episode.is_false_premise else wanted


def _start_view(plan: Plan, entry: SceneEntry, planned: PlannedJob) -> StartView | None:
    """Returns the conditions on the start of an episode; `None` if there are none."""
    # in ids of objects, because the validator has no scene with which it could evaluate the instruction
    episode, info = planned.episode, entry.info
    if plan.language is not None and plan.language.exchangeable:
        return _choice_view(plan, plan.language, entry, planned)
    if plan.language is not None:
        return _language_view(plan, plan.language, info, planned)
    within_rad = IN_FRONT_RAD if says_in_front(episode.template_id) else None
    if plan.instructions.unique == "off":
        return None if within_rad is None else StartView(within_rad=within_rad)
    target = {info.target(episode.target_id).instance_id}
    same_category = referents(info, episode.category) - target
    is_exempt = episode.category in plan.part(episode.scene).ambiguous
    others = frozenset() if is_exempt else referents_of(episode, info) - target
    return StartView(
        within_rad=within_rad, other_referents=tuple(sorted(others)), same_category=tuple(sorted(same_category))
    )


def _language_view(plan: Plan, language: LanguageSpec, info: SceneInfo, planned: PlannedJob) -> StartView | None:
    """Returns the conditions of a language block on the start of an episode; `None` if there are none."""
    if not language.in_view:
        return None
    episode, ranks = planned.episode, None
    if language.balanced:
        rng = _rank_rng(plan, planned)
        ranks = (float(rng.random()), float(rng.random()))
    same_category = referents(info, episode.category) - {info.target(episode.target_id).instance_id}
    return StartView(same_category=tuple(sorted(same_category)), least_same_category=language.in_view, ranks=ranks)


def _choice_view(plan: Plan, language: LanguageSpec, entry: SceneEntry, planned: PlannedJob) -> StartView:
    """Returns conditions that let the worker draw the target among the targets of the same category in the cell."""
    episode = planned.episode
    pool = scene_cells(plan, plan.part(episode.scene), entry).pool(episode.split, episode.tier)
    among = sorted(target.instance_id for target in pool if target.category == episode.category)
    choice = TargetChoice(
        around=entry.info.target(episode.target_id).instance_id,
        among=tuple(among),
        share=float(_rank_rng(plan, planned).random()),
    )
    return StartView(least_same_category=language.in_view, choice=choice)


def _rank_rng(plan: Plan, planned: PlannedJob) -> np.random.Generator:
    """Returns a random generator that yields the same numbers for all draws of an episode.

    Attempts fail more often if few starts suit the drawn rank or target. If redraws used new random numbers, such ranks
    and targets would be too rare in the dataset.
    """
    return np.random.default_rng(np.random.SeedSequence((plan.seed, _RANK_STREAM, planned.index)))


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
