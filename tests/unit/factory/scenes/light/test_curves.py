"""Normals are smooth over the pieces of a round surface and separate at sharp edges."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from factory.scenes.light.charts import SQUARE, find_charts, interpolate, unwrap
from factory.scenes.light.curves import corner_normals, find_bends
from tests.builders.scene import Box
from tests.builders.solids import box_triangles


def drum(sides: int, radius: float = 0.3, height: float = 0.8, taper: float = 1.0) -> np.ndarray:
    """The side of an upright prism or frustum, two triangles per face, counter-clockwise from outside."""
    turn = 2 * np.pi * np.arange(sides + 1) / sides
    ring = np.stack((radius * np.cos(turn), radius * np.sin(turn)), axis=1)
    faces = []
    for (x0, y0), (x1, y1) in pairwise(ring):
        a, b = (x0, y0, 0.0), (x1, y1, 0.0)
        c, d = (taper * x1, taper * y1, height), (taper * x0, taper * y0, height)
        faces += [(a, b, c), (a, c, d)]
    return np.array(faces)


def zeros(triangles: np.ndarray) -> np.ndarray:
    return np.zeros(len(triangles), np.int64)


@pytest.mark.parametrize("sides", [8, 12, 20])
def test_normals_of_a_drum_point_away_from_its_axis(sides: int) -> None:
    triangles = drum(sides)
    outward = triangles * (1, 1, 0)
    outward /= np.linalg.norm(outward, axis=2, keepdims=True)
    assert corner_normals(triangles, zeros(triangles)) == pytest.approx(outward, abs=1e-6)


def test_the_sides_of_a_hexagon_stay_flat() -> None:
    triangles = drum(6)
    charts = find_charts(triangles, zeros(triangles))
    assert not find_bends(charts, triangles, zeros(triangles)).is_bent.any()


def test_a_box_has_no_smooth_edges() -> None:
    triangles = box_triangles([Box((0, 0, 0), (1, 1, 1))])
    charts = find_charts(triangles, zeros(triangles))
    bends = find_bends(charts, triangles, zeros(triangles))
    assert not bends.is_bent.any()
    assert bends.normals(np.arange(6), np.full((6, 2), 0.5)) == pytest.approx(charts.axes[:, 2], abs=1e-5)


def test_normals_agree_where_two_pieces_of_a_drum_meet() -> None:
    triangles = drum(12)
    charts = find_charts(triangles, zeros(triangles))
    bends = find_bends(charts, triangles, zeros(triangles))
    assert bends.is_bent.all()
    ends = []
    for share in ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)):
        place = np.full((12, 2), share)
        spot = interpolate(charts.anchors, np.arange(12), place[:, None])[:, 0]
        ends += list(zip(spot.round(4).tolist(), bends.normals(np.arange(12), place), strict=True))
    for spot, normal in ends:
        assert normal == pytest.approx(np.array(spot) * (1, 1, 0) / 0.3, abs=1e-3)


def test_normals_agree_at_the_shared_corners_of_a_frustum() -> None:
    triangles = drum(12, height=0.1, taper=0.2)
    charts = find_charts(triangles, zeros(triangles))
    bends = find_bends(charts, triangles, zeros(triangles))
    corners = charts.anchors.reshape(-1, 3).round(6)
    normals = bends.normals(np.repeat(np.arange(12), 4), np.tile(SQUARE, (12, 1)))
    for corner, normal in zip(corners, normals, strict=True):
        same = normals[(corners == corner).all(axis=1)]
        assert len(same) == 2
        assert same == pytest.approx(np.tile(normal, (2, 1)), abs=1e-6)


def test_normals_are_not_smoothed_across_groups() -> None:
    triangles = drum(12)
    groups = np.repeat(np.arange(12), 2)
    charts = find_charts(triangles, groups)
    assert not find_bends(charts, triangles, groups).is_bent.any()


def test_a_curved_piece_gets_at_least_two_texels_across_its_curve() -> None:
    triangles = drum(12, radius=0.02, height=0.04)
    charts = find_charts(triangles, zeros(triangles))
    bends = find_bends(charts, triangles, zeros(triangles))
    layout = unwrap(charts, least=bends.least_texels())
    assert (layout.size.max(axis=1) >= 2).all()
    assert (unwrap(charts).size == 1).all()


def test_a_corner_that_very_many_triangles_share_stays_flat() -> None:
    turn = 2 * np.pi * np.arange(201) / 200
    rim = np.stack((np.cos(turn), np.sin(turn), np.full(201, -0.2)), axis=1)
    triangles = np.stack((np.zeros((200, 3)), rim[:-1], rim[1:]), axis=1)
    normals = corner_normals(triangles, zeros(triangles))
    flat = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    flat /= np.linalg.norm(flat, axis=1, keepdims=True)
    assert normals[:, 0] == pytest.approx(flat)
    assert np.isfinite(normals).all()
