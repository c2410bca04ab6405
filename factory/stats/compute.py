"""All statistics of a dataset, from its tables. Reads through `rows`, computes through the pure modules."""

from __future__ import annotations

from coordinator.archive.place import Place
from factory.stats import attempts, counts, rollouts
from factory.stats.model import Statistics
from factory.stats.rows import Rows, read_rows

__all__ = ["compute_statistics", "measure_dataset"]

_LARGEST = 3


def measure_dataset(root: Place) -> Statistics:
    """Returns every table of a dataset directory; what is left out stands in the remarks.

    Raises:
        WorldError: there is no dataset, or it is of a newer format.
        ArchiveCorrupt: its description or its table of episodes cannot be read at all.
    """
    return compute_statistics(str(root), read_rows(root))


def compute_statistics(name: str, rows: Rows) -> Statistics:
    """Returns every table of the rows of a dataset called `name`."""
    plan, episodes, failures = rows.meta.plan, rows.episodes, rows.failures
    scenes = [scene.name for scene in plan.scenes]
    radius_m = plan.task.success_radius_m
    categories = counts.count_categories(episodes, plan)
    return Statistics(
        dataset=name,
        run=rows.meta.run,
        expert=plan.expert,
        episodes=len(episodes),
        planned=rows.meta.planned,
        complete=rows.meta.complete,
        success_radius_m=radius_m,
        remarks=tuple(rows.remarks),
        scenes=rollouts.by_scene(episodes, scenes),
        splits=rollouts.by_split(episodes),
        tiers=rollouts.by_tier(episodes),
        scene_tiers=rollouts.by_scene_tier(episodes, scenes),
        categories=categories,
        three_largest_share=counts.share_of_largest(categories, _LARGEST),
        templates=counts.count_templates(episodes),
        attempts=None if failures is None else attempts.attempt_rows(episodes, failures, scenes),
        cells=attempts.cell_rows(episodes, failures, plan),
        navigation_error=rollouts.navigation_errors(episodes, scenes, radius_m),
        correlation=rollouts.correlations(episodes, scenes),
        overlap=counts.overlaps(episodes, plan),
    )
