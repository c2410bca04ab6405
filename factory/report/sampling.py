"""Chooses the episodes that a report opens: for frames as many scenes and categories as there is room for. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import zip_longest

from schemas.dataset import EpisodeSummary

__all__ = ["choose_samples", "spread_evenly"]


def choose_samples(episodes: Sequence[EpisodeSummary], count: int) -> list[EpisodeSummary]:
    """Returns up to `count` episodes, the scenes taking turns, each with its categories in turn.

    Of a category, the episode is taken in which the target was seen for the largest share of the steps; on a tie the
    first. The result depends on the rows only.
    """
    scenes = dict.fromkeys(row.scene for row in episodes)
    queues = [_in_turn([row for row in episodes if row.scene == scene]) for scene in scenes]
    mixed = [row for turn in zip_longest(*queues) for row in turn if row is not None]
    return sorted(mixed[:count], key=lambda row: (list(scenes).index(row.scene), row.index))


def spread_evenly(episodes: Sequence[EpisodeSummary], count: int) -> list[EpisodeSummary]:
    """Returns all episodes, or `count` of them evenly spread from the first to the last."""
    if len(episodes) <= count:
        return list(episodes)
    return [episodes[place * (len(episodes) - 1) // max(count - 1, 1)] for place in range(count)]


def _in_turn(episodes: Sequence[EpisodeSummary]) -> list[EpisodeSummary]:
    """Returns the best episode of each category, then the second of each, and so on."""
    by_category: dict[str, list[EpisodeSummary]] = {}
    for row in episodes:
        by_category.setdefault(row.target_category, []).append(row)
    ranked = [
        sorted(rows, key=lambda row: (-row.steps_visible / row.num_steps, row.index)) for rows in by_category.values()
    ]
    return [row for turn in zip_longest(*ranked) for row in turn if row is not None]
