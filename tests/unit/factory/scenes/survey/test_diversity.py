"""Distances between layouts and their distributions."""

from __future__ import annotations

import numpy as np
from click.testing import CliRunner

from factory.cli.scene import survey
from factory.scenes.survey.diversity import LayoutFacts, map_distance, nearest_neighbours, spreads


def walls(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).random((20, 31)) < 0.3


def test_a_turned_or_mirrored_map_is_the_same_layout() -> None:
    one = walls(0)
    assert (
        map_distance(one, np.rot90(one)) == map_distance(one, one[::-1, ::-1]) == map_distance(one, one[:, ::-1]) == 0.0
    )


def test_maps_without_common_cells_have_distance_one() -> None:
    one, two = np.zeros((6, 6), bool), np.zeros((6, 6), bool)
    one[2, 2], two[0, 0] = True, True
    assert map_distance(one, two) == 1.0


def test_the_nearest_neighbour_of_a_layout_is_the_most_similar_one() -> None:
    similar = walls(0).copy()
    similar[0, :5] ^= True
    nearest = nearest_neighbours({4: walls(0), 7: walls(1), 9: similar})
    assert nearest[4][0] == 9
    assert nearest[9] == (4, nearest[4][1])
    assert nearest[7][1] > nearest[4][1] > 0.0


def test_a_spread_summarises_a_measure_over_all_layouts() -> None:
    layouts = [
        LayoutFacts(seed, rooms, 80.0, 40.0, 1, 3, 20, 50, 9.0, 6.0, 4.0) for seed, rooms in ((0, 5), (1, 7), (5, 9))
    ]
    spread = spreads(layouts)
    assert "seed" not in spread
    assert (spread["rooms"].least, spread["rooms"].median, spread["rooms"].greatest) == (5.0, 7.0, 9.0)
    assert spread["area_m2"].deviation == 0.0
    assert spreads([]) == {}


def test_a_survey_requires_either_a_scene_or_a_family() -> None:
    for arguments in ([], ["office", "--family", "office"]):
        outcome = CliRunner().invoke(survey, arguments)
        assert outcome.exit_code == 2
        assert "either SCENE|PACKAGE or --family NAME" in outcome.output
