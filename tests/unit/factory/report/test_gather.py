"""The choice of sample episodes from the rows: scenes and categories in turn."""

from __future__ import annotations

from factory.report.gather import choose_samples
from factory.stats.rows import spread_evenly
from tests.builders.statistics import episode_row


def test_scenes_are_chosen_in_turn() -> None:
    rows = [episode_row(n) for n in range(1, 9)] + [episode_row(9, scene="hospital")]
    assert [row.scene for row in choose_samples(rows, 2)] == ["office", "hospital"]


def test_categories_of_a_scene_are_chosen_in_turn() -> None:
    rows = [episode_row(1), episode_row(2), episode_row(3, target_category="sofa")]
    assert [row.index for row in choose_samples(rows, 2)] == [1, 3]


def test_the_episode_with_the_longest_target_visibility_is_chosen() -> None:
    rows = [episode_row(1, num_steps=100, steps_visible=40), episode_row(2, num_steps=100, steps_visible=90)]
    assert [row.index for row in choose_samples(rows, 1)] == [2]


def test_fewer_episodes_than_requested_are_all_shown() -> None:
    assert len(choose_samples([episode_row(1), episode_row(2)], 8)) == 2
    assert choose_samples([], 8) == []


def test_sampled_episodes_are_spread_evenly() -> None:
    rows = [episode_row(n) for n in range(1, 102)]
    assert [row.index for row in spread_evenly(rows, 5)] == [1, 26, 51, 76, 101]
    assert spread_evenly(rows, 101) == rows
