"""Searched starts in rooms of boxes, whose distances and directions are computed by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from schemas.config import TaskConfig
from schemas.language.graph.scene_graph import build_graph
from schemas.scene import CompiledScene
from schemas.start_survey import STEP_M, ClearSurvey, ExchangeStarts, ExchangeSurvey
from schemas.terms import Tier
from tests.builders.scene import Box, build_scene, room_walls

ROOM = room_walls((-7.0, -5.0), (7.0, 5.0))
POINT = -0.075, -0.075
"""Point of the lattice: the grid begins at the outer walls, and cells are 5 cm."""


def crate(x: float, y: float) -> Box:
    return Box((x - 0.2, y - 0.2, 0.0), (x + 0.2, y + 0.2, 0.5), category="crate")


def starts_of(*extra: Box, tier: Tier = Tier.NEAR, noise_rad: float = 0.75) -> ExchangeStarts:
    """Returns the starts from which two crates could be the target, in a room with some boxes."""
    scene = build_scene((*ROOM, *extra))
    ids = [target.instance_id for target in scene.info.targets]
    return ExchangeSurvey(scene, build_graph(scene)).starts(ids, tier, 2, noise_rad, TaskConfig())


def headings_at(starts: ExchangeStarts, point: tuple[float, float]) -> list[int]:
    """Returns the headings of the starts at a point, degrees."""
    here = np.abs(starts.poses[:, :2] - point).max(axis=1) < 1e-6
    return sorted(round(math.degrees(yaw)) for yaw in starts.poses[here, 2])


def test_both_objects_are_within_the_angle_of_every_heading():
    # from the point, the crates are 3.46 and 3.39 m away, 27.1 degrees to the left and 24.9 degrees to the right
    pair = crate(3.0, 1.5), crate(3.0, -1.5)
    assert headings_at(starts_of(*pair, noise_rad=math.radians(43)), POINT) == [-10, 0, 10]
    assert headings_at(starts_of(*pair, noise_rad=math.radians(29)), POINT) == [0]
    assert headings_at(starts_of(*pair, noise_rad=math.radians(25)), POINT) == []
    assert headings_at(starts_of(*pair, tier=Tier.MID), POINT) == []  # both are nearer than 3.5 m
    assert headings_at(starts_of(*pair, tier=Tier.MID), (POINT[0] - 1.0, POINT[1])) == [-20, -10, 0, 10, 20]


def test_a_wall_before_one_object_or_a_common_success_region_leaves_no_start():
    wall = Box((1.5, -3.0, 0.0), (1.6, 0.0, 2.5))
    assert headings_at(starts_of(crate(3.0, 1.5), crate(3.0, -1.5), wall), POINT) == []
    assert len(starts_of(crate(3.0, 0.9), crate(3.0, -0.9)).poses) == 0  # 1.8 m apart, with a radius of 1 m


def test_starts_are_on_the_lattice_and_those_of_an_object_are_selected():
    starts = starts_of(*(crate(x, y) for x in (3.0, -3.0) for y in (1.5, -1.5)))
    steps = (starts.poses[:, :2] - POINT) / STEP_M
    assert len(starts.poses) > 100
    assert np.allclose(steps, steps.round())
    assert (starts.choices.sum(axis=1) >= 2).all()
    first = starts.of(0)
    assert len(first.poses) == starts.choices[:, 0].sum() < len(starts.poses)
    assert first.choices[:, 0].all()


TARGET, OTHER = crate(0.0, 0.0), crate(-4.0, 3.0)
SCREEN = Box((-0.3, 1.0, 0.0), (0.45, 1.1, 2.5))
"""Hides the target from the point (0.075, 1.575)."""


def clear_share(scene: CompiledScene, half_deg: float, needs_sight: bool = True) -> float:
    """Returns the share of starts that face the target from 1.5 to 1.6 m and do not show the other crate.

    Five points of the lattice of 0.5 m are in this range: (1.575, 0.075), (0.075, 1.575), (-1.425, 0.575),
    (1.075, 1.075) and (0.575, -1.425). From them, the angle between the crates is 30, 107, 159, 66 and 24 degrees.
    """
    survey = ClearSurvey(scene, build_graph(scene), "crate", fov_rad=math.radians(2 * half_deg))
    target, other = scene.info.targets
    return survey.share(target, frozenset({other.instance_id}), (1.5, 1.6), 0.0, needs_sight, TaskConfig())


@pytest.mark.parametrize(("half_deg", "alone"), [(10, 5), (26, 4), (40, 3), (80, 2)])
def test_the_share_counts_the_starts_that_do_not_show_the_other_object(half_deg, alone):
    assert clear_share(build_scene((*ROOM, TARGET, OTHER)), half_deg) == pytest.approx(alone / 5)


def test_a_start_without_sight_of_the_target_is_no_start_or_a_start_that_does_not_fit():
    scene = build_scene((*ROOM, TARGET, OTHER, SCREEN))
    assert clear_share(scene, 26) == pytest.approx(3 / 4)
    assert clear_share(scene, 26, needs_sight=False) == pytest.approx(3 / 5)


def test_a_hidden_object_is_not_shown_and_a_range_without_points_has_no_start():
    between = Box((-3.4, -5.0, 0.0), (-3.3, 5.0, 2.5))  # the other crate is in another room
    scene = build_scene((*ROOM, TARGET, OTHER, between))
    assert clear_share(scene, 80) == 1.0
    survey = ClearSurvey(scene, build_graph(scene), "crate", fov_rad=1.0)
    assert survey.share(scene.info.targets[0], frozenset(), (40.0, 50.0), 0.0, True, TaskConfig()) == 0.0
