"""Computes rollout statistics, navigation errors, and the fit of trajectory length against spawn distance, by group.

Pure functions; no I/O.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

from factory.stats import paper
from factory.stats.measures import deviation_of, fit_line, interval_of, mean_of, median_of, quantiles_of, share_of
from factory.stats.statistics import ErrorRow, FarRow, Fit, Published, RolloutRow
from schemas.dataset.rows import EpisodeSummary
from schemas.terms import Split, SuccessMeasure, Tier, family_of

ALL = "all"
"""Name of the group of all episodes."""
Episodes = Sequence[EpisodeSummary]
_STRAIGHT_M = 0.001
"""Tolerance when a geodesic distance is compared with the straight distance, metres, because poses are float32."""


def by_measure(episodes: Episodes, success: SuccessMeasure) -> list[EpisodeSummary]:
    """Returns the episodes with `spawn_dist_m` and `final_ne_m` replaced by the distances of a success measure.

    Omits episodes without these distances: in scenes of older versions, the distance to the footprint is not recorded.
    """
    if success is SuccessMeasure.CENTROID:
        return list(episodes)
    return [
        row.model_copy(update={"spawn_dist_m": row.spawn_surface_m, "final_ne_m": row.final_surface_m})
        for row in episodes
        if row.spawn_surface_m is not None and row.final_surface_m is not None
    ]


def _family(row: EpisodeSummary) -> str:
    return family_of(row.scene)


def by_scene(episodes: Episodes, scenes: Iterable[str]) -> tuple[RolloutRow, ...]:
    """Returns one row for each scene of the plan, and one for all scenes (paper Table V, Fig. 9)."""
    return _rows(episodes, scenes, _family, paper.SCENES)


def by_split(episodes: Episodes) -> tuple[RolloutRow, ...]:
    """Returns one row for each split that the paper has or that has episodes, and one for all splits (Table VI)."""
    present = {row.split for row in episodes}
    splits = [split for split in Split if split in paper.SPLITS or split in present]
    return _rows(episodes, splits, lambda row: row.split, paper.SPLITS)


def by_tier(episodes: Episodes) -> tuple[RolloutRow, ...]:
    """Returns one row for each tier, and one for all tiers (paper Table VII, Fig. 10)."""
    return _rows(episodes, Tier, lambda row: row.spawn_tier, paper.TIERS)


def by_scene_tier(episodes: Episodes, scenes: Iterable[str]) -> tuple[RolloutRow, ...]:
    """Returns one row for each scene and tier; the paper has no such table."""
    groups = [f"{scene} / {tier}" for scene in scenes for tier in Tier]
    return _rows(episodes, groups, lambda row: f"{family_of(row.scene)} / {row.spawn_tier}", {})[:-1]


def navigation_errors(episodes: Episodes, scenes: Iterable[str], radius_m: float) -> tuple[ErrorRow, ...]:
    """Returns the quantiles of NE for each scene and for all (paper Fig. 8).

    Args:
        episodes: Rows of the episodes.
        scenes: Scene names of the plan.
        radius_m: Success radius, metres.
    """
    return tuple(
        _error_row(name, group, radius_m, paper.NAVIGATION_ERROR if name == ALL else None)
        for name, group in _groups(episodes, scenes, _family)
    )


def correlations(episodes: Episodes, scenes: Iterable[str]) -> tuple[Fit, ...]:
    """Returns fits of trajectory length against spawn distance for all episodes, each scene and each tier (Fig. 11)."""
    groups = [*_groups(episodes, scenes, _family)]
    groups = [groups[-1], *groups[:-1], *list(_groups(episodes, Tier, lambda row: row.spawn_tier))[:-1]]
    return tuple(
        fit_line(name, [row.spawn_dist_m for row in group], [row.trajectory_length_m for row in group])
        for name, group in groups
    )


def far_starts(episodes: Episodes, scenes: Iterable[str], radius_m: float, least_m: float) -> tuple[FarRow, ...]:
    """Returns, for each scene and for all scenes, how far along the floor far starts are from their targets.

    Args:
        episodes: Rows of the episodes.
        scenes: Scene names of the plan.
        radius_m: Success radius, metres.
        least_m: Smallest distance along the floor that the plan permits, metres.
    """
    far = [row for row in episodes if row.spawn_tier is Tier.FAR]
    return tuple(_far_row(name, group, radius_m, least_m) for name, group in _groups(far, scenes, _family))


def _far_row(scene: str, group: Episodes, radius_m: float, least_m: float) -> FarRow:
    ways = [(row.geodesic_m + radius_m, row.spawn_dist_m) for row in group if row.geodesic_m is not None]
    lengths = [length for length, _ in ways]
    return FarRow(
        scene=scene,
        n=len(ways),
        mean_m=mean_of(lengths),
        interval_m=interval_of(lengths),
        least_m=least_m,
        short=share_of(sum(length < least_m for length in lengths), len(ways)),
        corner=share_of(sum(length > straight + _STRAIGHT_M for length, straight in ways), len(ways)),
    )


def _groups(
    episodes: Episodes, names: Iterable[str], name_of: Callable[[EpisodeSummary], str]
) -> Iterator[tuple[str, Episodes]]:
    members: dict[str, list[EpisodeSummary]] = {str(name): [] for name in names}
    for row in episodes:
        members.setdefault(str(name_of(row)), []).append(row)
    yield from members.items()
    yield ALL, episodes


def _rows(
    episodes: Episodes,
    names: Iterable[str],
    name_of: Callable[[EpisodeSummary], str],
    published: Mapping[str, Published],
) -> tuple[RolloutRow, ...]:
    return tuple(
        _rollout_row(name, group, len(episodes), paper.OVERALL if name == ALL else published.get(name))
        for name, group in _groups(episodes, names, name_of)
    )


def _rollout_row(name: str, group: Episodes, total: int, published: Published | None) -> RolloutRow:
    lengths = [row.trajectory_length_m for row in group]
    steps = [row.num_steps for row in group]
    return RolloutRow(
        group=name,
        n=len(group),
        share=len(group) / total if total else None,
        ne_mean_m=mean_of([row.final_ne_m for row in group]),
        tl_mean_m=mean_of(lengths),
        tl_median_m=median_of(lengths),
        steps_mean=mean_of(steps),
        steps_median=median_of(steps),
        ne_interval_m=interval_of([row.final_ne_m for row in group]),
        tl_interval_m=interval_of(lengths),
        steps_interval=interval_of(steps),
        paper=published,
    )


def _error_row(name: str, group: Episodes, radius_m: float, published: Published | None) -> ErrorRow:
    errors = [row.final_ne_m for row in group]
    return ErrorRow(
        group=name,
        n=len(errors),
        mean=mean_of(errors),
        std=deviation_of(errors),
        interval=interval_of(errors),
        quantiles=quantiles_of(errors),
        within_radius=share_of(sum(error <= radius_m for error in errors), len(errors)),
        paper=published,
    )
