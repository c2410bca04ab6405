"""The contact shadow beside objects on the floor."""

from __future__ import annotations

import numpy as np
import pytest

from factory.scenes.light.bake import contact_shade
from tests.builders.scene import Box
from tests.builders.solids import box_triangles

FLOOR = Box((-3, -3, -0.1), (3, 3, 0.0))
LEG = Box((-0.01, -0.01, 0.0), (0.01, 0.01, 0.7))
UP = np.array([[0.0, 0.0, 1.0]])


def shade(
    *places: tuple[float, float, float], boxes: tuple[Box, ...] = (FLOOR, LEG), floor_m: float = 0.0
) -> list[float]:
    points = np.array(places)
    return list(contact_shade(box_triangles(list(boxes)), floor_m, points, np.repeat(UP, len(points), axis=0)))


def test_the_floor_darkens_towards_a_thin_leg() -> None:
    beside, near, far = shade((0.02, 0.0, 0.0), (0.1, 0.0, 0.0), (1.0, 0.0, 0.0))
    assert beside < 0.5 < near < far == pytest.approx(1.0, abs=0.01)


def test_only_the_floor_is_darkened() -> None:
    points = np.array([[0.02, 0.0, 0.4], [0.02, 0.0, 0.0]])
    sideways = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
    assert contact_shade(box_triangles([FLOOR, LEG]), 0.0, points, sideways) == pytest.approx(1.0)


def test_objects_above_the_floor_cast_no_contact_shadow() -> None:
    lamp = Box((-0.01, -0.01, 0.5), (0.01, 0.01, 0.7))
    assert shade((0.02, 0.0, 0.0), boxes=(FLOOR, lamp)) == pytest.approx([1.0])


def test_contact_shadows_work_at_any_floor_height() -> None:
    raised = Box((-3, -3, 1.9), (3, 3, 2.0)), Box((-0.01, -0.01, 2.0), (0.01, 0.01, 2.7))
    (beside,) = shade((0.02, 0.0, 2.0), boxes=raised, floor_m=2.0)
    assert beside < 0.5


def test_a_scene_with_an_empty_floor_has_no_contact_shadow() -> None:
    assert shade((0.0, 0.0, 0.0), boxes=(FLOOR,)) == pytest.approx([1.0])
