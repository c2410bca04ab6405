"""Baked light in rooms of boxes: dark and bright areas."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from factory.scenes.light import LightMap, bake_light
from factory.scenes.light.smooth import fill_hidden, smooth_charts
from tests.builders.scene import Box, room_walls
from tests.builders.solids import box_triangles

CEILING = Box((-3.2, -3.2, 2.5), (3.2, 3.2, 2.6))
LAMP = Box((-0.6, -0.6, 2.45), (0.6, 0.6, 2.49))
ROOM = (*room_walls((-3.0, -3.0), (3.0, 3.0)), CEILING, LAMP)
LAMP_NUMBER = 6
TABLE = Box((1.0, -0.5, 0.6), (2.0, 0.5, 0.65))
CRATE = Box((-2.2, -0.4, 0.0), (-1.4, 0.4, 0.6))


def bake(boxes: Sequence[Box], lamps: Sequence[int] = (LAMP_NUMBER,)) -> LightMap:
    brightness = np.zeros(len(boxes))
    brightness[list(lamps)] = 1.0
    groups = np.arange(len(boxes))
    return bake_light(box_triangles(boxes), np.repeat(groups, 12), np.repeat(brightness, 12), 0.0)


def light_at(light: LightMap, boxes: Sequence[Box], box: int, axis: int, sign: int, place: tuple[float, ...]) -> float:
    """Returns the mean of the three channels at a position on one face of a box; `axis` and `sign` give its normal."""
    triangles = box_triangles(boxes)
    cross = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    for row in range(12 * box, 12 * box + 12):
        if cross[row, axis] * sign > 0.9 * np.linalg.norm(cross[row]):
            a, b, c = triangles[row]
            s, t = np.linalg.lstsq(np.column_stack((b - a, c - a)), np.asarray(place) - a, rcond=None)[0]
            if s >= -1e-9 and t >= -1e-9 and s + t <= 1 + 1e-9:
                uv = light.uvs[row, 0] * (1 - s - t) + light.uvs[row, 1] * s + light.uvs[row, 2] * t
                rows, columns = light.picture.shape[:2]
                return float(light.picture[int(uv[1] * rows), int(uv[0] * columns)].mean())
    raise AssertionError(f"no face of box {box} has {place}")


def floor_light(light: LightMap, boxes: Sequence[Box], x: float, y: float) -> float:
    return light_at(light, boxes, 0, 2, 1, (x, y, 0.0))


def light_in(light: LightMap, triangle: int, weights: tuple[float, float, float]) -> float:
    """Returns the mean of the three channels at a point of a triangle, interpolated as in the renderer."""
    rows, columns = light.picture.shape[:2]
    u, v = np.array(weights) @ light.uvs[triangle] * (columns, rows) - 0.5
    column, row = int(u), int(v)
    four = light.picture[row : row + 2, column : column + 2].astype(float).mean(axis=2)
    return float(np.array((row + 1 - v, v - row)) @ four @ np.array((column + 1 - u, u - column)))


@pytest.mark.parametrize("lamps", [((0.0, 0.0),), ((-2.0, -1.6), (2.0, -1.6), (-2.0, 1.6), (2.0, 1.6))])
def test_the_light_of_a_symmetric_room_is_symmetric(lamps: tuple[tuple[float, float], ...]) -> None:
    """If the halves of a large face differ, too few rays were traced; this noise is visible as clouds."""
    halves = [(x, y) for x in (-1, 1) for y in (-1, 1)]
    desks = [Box((1.5 * x - 0.6, y - 0.3, 0.7), (1.5 * x + 0.6, y + 0.3, 0.74)) for x, y in halves]
    lit = [Box((x - 0.3, y - 0.6, 2.45), (x + 0.3, y + 0.6, 2.49)) for x, y in lamps]
    boxes = (*ROOM[:LAMP_NUMBER], *lit, *desks)
    light = bake(boxes, lamps=range(LAMP_NUMBER, LAMP_NUMBER + len(lit)))
    places = [(y, z) for y in np.arange(0.13, 2.9, 0.21) for z in np.arange(0.1, 2.3, 0.17)]
    values = [[light_at(light, boxes, 1, 0, 1, (-3.0, side * y, z)) for side in (-1, 1)] for y, z in places]
    assert np.sqrt(np.mean(np.diff(values, axis=1) ** 2)) < 1.4


def test_the_light_of_a_cone_has_no_seams_between_its_faces() -> None:
    turn = 2 * np.pi * np.arange(13) / 12
    low, high = (
        np.column_stack((0.9 + radius * np.cos(turn), 0.4 + radius * np.sin(turn), np.full(13, z)))
        for radius, z in ((0.28, 0.02), (0.05, 0.09))
    )
    sides = [face for k in range(12) for face in ((low[k], low[k + 1], high[k + 1]), (low[k], high[k + 1], high[k]))]
    room, first = box_triangles(ROOM), 12 * len(ROOM)
    groups = np.append(np.repeat(np.arange(len(ROOM)), 12), np.full(24, len(ROOM)))
    light = bake_light(np.concatenate((room, sides)), groups, np.where(groups == LAMP_NUMBER, 1.0, 0.0), 0.0)
    for share in (0.2, 0.5, 0.8):
        before = [light_in(light, first + 2 * k, (0.0, 1 - share, share)) for k in range(12)]
        after = [light_in(light, first + 2 * ((k + 1) % 12) + 1, (1 - share, 0.0, share)) for k in range(12)]
        assert before == pytest.approx(after, abs=3.0)


def test_a_flat_object_on_a_table_leaves_no_smudge_around_it() -> None:
    keyboard = Box((1.31, -0.22, 0.658), (1.47, 0.2, 0.678))
    boxes = (*ROOM, TABLE)
    bare, used = bake(boxes), bake((*boxes, keyboard))
    places = [(x, y, 0.65) for x in (1.26, 1.52) for y in (-0.15, -0.05, 0.05, 0.15)]
    darkest = min(light_at(used, boxes, 7, 2, 1, at) - light_at(bare, boxes, 7, 2, 1, at) for at in places)
    assert darkest > -30.0


def test_a_corner_is_darker_than_the_open_floor() -> None:
    light = bake(ROOM)
    assert floor_light(light, ROOM, -2.9, -2.9) < 0.8 * floor_light(light, ROOM, 0.0, 0.0)


def test_the_floor_under_a_table_is_darker_than_beside_it() -> None:
    boxes = (*ROOM, TABLE)
    light = bake(boxes)
    assert floor_light(light, boxes, 1.5, 0.0) < 0.75 * floor_light(light, boxes, 1.5, 1.3)


def test_a_crate_has_a_contact_shadow_that_fades_with_distance() -> None:
    boxes = (*ROOM, CRATE)
    light = bake(boxes)
    beside, near, open_floor = (floor_light(light, boxes, -2.2 - gap, 0.0) for gap in (0.04, 0.3, 0.6))
    assert beside < near
    assert beside < 0.9 * floor_light(bake(ROOM), ROOM, -2.24, 0.0)
    assert open_floor > 0


def test_hidden_texels_do_not_darken_visible_ones() -> None:
    boxes = (*ROOM, CRATE)
    assert floor_light(bake(boxes), boxes, -1.38, 0.0) > 40


def test_light_does_not_pass_through_walls() -> None:
    wall = Box((0.9, -3.0, 0.0), (1.1, 3.0, 2.5))
    boxes = (*ROOM, wall)
    light = bake(boxes)
    assert floor_light(light, boxes, 2.0, 0.0) < 0.75 * floor_light(light, boxes, -0.5, 0.0)


def test_emissive_surfaces_are_fully_bright() -> None:
    light = bake(ROOM)
    assert light_at(light, ROOM, LAMP_NUMBER, 2, -1, (0.0, 0.0, 2.45)) == 255


def test_a_scene_without_lamps_is_lit() -> None:
    light = bake(ROOM[:-2], lamps=())
    assert 120 < floor_light(light, ROOM, 0.5, 0.5) < 255


def test_no_visible_surface_is_black() -> None:
    boxes = (*ROOM, TABLE, CRATE)
    light = bake(boxes)
    assert light_at(light, boxes, 7, 2, -1, (1.5, 0.0, 0.6)) > 40
    assert light.picture[light.picture.max(axis=2) > 0].min() > 20


def test_the_same_scene_gives_the_same_light() -> None:
    one, other = bake(ROOM), bake(ROOM)
    assert one.picture.tobytes() == other.picture.tobytes()
    assert one.uvs.tobytes() == other.uvs.tobytes()


def test_exposure_reduces_bright_areas_more_than_dark_ones() -> None:
    triangles, groups = box_triangles(ROOM), np.repeat(np.arange(len(ROOM)), 12)
    brightness = np.repeat(np.arange(len(ROOM)) == LAMP_NUMBER, 12).astype(float)
    pale, dark = (bake_light(triangles, groups, brightness, 0.0, np.full(len(triangles), grey)) for grey in (0.8, 0.2))
    assert floor_light(pale, ROOM, -2.5, -2.5) < floor_light(dark, ROOM, -2.5, -2.5) - 20


def test_a_hidden_piece_gets_a_single_texel() -> None:
    boxes = (*ROOM, CRATE)
    light = bake(boxes)
    under = np.flatnonzero(box_triangles(boxes)[12 * 7 :, :, 2].max(axis=1) == 0.0) + 12 * 7
    assert len(under) == 2
    assert np.ptp(light.uvs[under].reshape(-1, 2), axis=0) == pytest.approx(0.0)


def test_smoothing_never_mixes_charts() -> None:
    owner = np.repeat([[0, 0, 1, 1]], 3, axis=0)
    values = np.where(owner == 0, 1.0, 5.0)
    smooth, is_near = smooth_charts(values, np.ones_like(owner, bool), owner)
    assert smooth == pytest.approx(values)
    assert is_near.all()


def test_unknown_texels_are_filled_from_their_own_chart() -> None:
    owner = np.array([[0, 0, 0, 1, 1, -1]])
    known = np.array([[True, False, False, False, False, False]])
    filled = fill_hidden(np.array([[2.0, 9, 9, 9, 9, 0]]), known, owner)
    assert filled.tolist() == [[2.0, 2.0, 2.0, pytest.approx(0.6), pytest.approx(0.6), 0.0]]
