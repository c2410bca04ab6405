"""Computes all statistics of a dataset from its tables. Reads files through `rows` only."""

from __future__ import annotations

from types import MappingProxyType

from coordinator.expansion.builtin import is_paper_plan
from factory.stats import counts, rollouts
from factory.stats.rows import Rows, read_rows
from factory.stats.statistics import Statistics
from schemas.storage.place import Place
from schemas.terms import SuccessMeasure, family_of

_LARGEST = 3
_OTHER = MappingProxyType(
    {
        SuccessMeasure.CENTROID: SuccessMeasure.SURFACE,
        SuccessMeasure.SURFACE: SuccessMeasure.CENTROID,
    }
)
_WITH_PAPER = ("scenes", "splits", "tiers", "categories", "templates", "attempts", "navigation_error")
"""Tables whose rows can contain values of the paper."""


def measure_dataset(root: Place, compare_paper: bool | None = None) -> Statistics:
    """Returns all statistics tables of a dataset directory; the remarks list the omitted data.

    Args:
        root: Directory or URL of the dataset.
        compare_paper: Whether to add the paper's values; `None` adds them for the plan `paper` and its parts.

    Raises:
        WorldError: The dataset does not exist, or its format is newer than this software.
        ArchiveCorrupt: `dataset_meta.json` or the table of episodes cannot be read.
    """
    return compute_statistics(str(root), read_rows(root), compare_paper)


def compute_statistics(name: str, rows: Rows, compare_paper: bool | None = None) -> Statistics:
    """Returns all statistics tables for the rows of the dataset `name`; see `measure_dataset`."""
    statistics = _all_tables(name, rows)
    is_wanted = is_paper_plan(rows.meta.plan) if compare_paper is None else compare_paper
    return statistics if is_wanted else _without_paper(statistics)


def _without_paper(statistics: Statistics) -> Statistics:
    changes: dict[str, object] = {"beside_paper": False}
    for table in _WITH_PAPER:
        rows = getattr(statistics, table)
        changes[table] = rows and tuple(row.model_copy(update={"paper": None}) for row in rows)
    return statistics.model_copy(update=changes)


def _all_tables(name: str, rows: Rows) -> Statistics:
    plan, failures = rows.meta.plan, rows.failures
    success, other = plan.task.success, _OTHER[plan.task.success]
    episodes = rollouts.by_measure(rows.episodes, success)
    episodes_by_other = rollouts.by_measure(rows.episodes, other)
    scenes = list(dict.fromkeys(family_of(scene.name) for scene in plan.scenes))
    radius_m = plan.task.success_radius_m
    categories = counts.count_categories(episodes, plan)
    return Statistics(
        dataset=name,
        run=rows.meta.run,
        expert=plan.expert,
        episodes=len(episodes),
        planned=rows.meta.planned,
        complete=rows.meta.complete,
        success=success,
        success_radius_m=radius_m,
        remarks=tuple(rows.remarks),
        scenes=rollouts.by_scene(episodes, scenes),
        splits=rollouts.by_split(episodes),
        tiers=rollouts.by_tier(episodes),
        scene_tiers=rollouts.by_scene_tier(episodes, scenes),
        categories=categories,
        three_largest_share=counts.share_of_largest(categories, _LARGEST),
        templates=counts.count_templates(episodes),
        attempts=None if failures is None else counts.attempt_rows(episodes, failures, scenes),
        cells=counts.cell_rows(episodes, failures, rows.meta.plans),
        navigation_error=rollouts.navigation_errors(episodes, scenes, radius_m),
        other_error=rollouts.navigation_errors(episodes_by_other, scenes, radius_m) if episodes_by_other else (),
        correlation=rollouts.correlations(episodes, scenes),
        overlap=counts.overlaps(episodes, plan),
        far=rollouts.far_starts(episodes, scenes, radius_m, plan.spawn.far_floor_m[0]),
    )
