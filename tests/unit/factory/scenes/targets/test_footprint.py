"""Footprints of objects: the exact convex hull in the plane, with a bounded number of vertices."""

from __future__ import annotations

import math

import numpy as np
import pytest

from factory.scenes.targets.candidates import footprint_of
from schemas.support.geometry import footprint_distances


def triangles_of(*corners: tuple[float, float]) -> np.ndarray:
    """Returns a fan of triangles over the corners, whose heights increase."""
    points = [(x, y, 0.1 * height) for height, (x, y) in enumerate(corners)]
    return np.array([(points[0], a, b) for a, b in zip(points, (*points[1:], points[0]), strict=True)], float)


def test_a_turned_table_has_its_four_corners_counter_clockwise() -> None:
    found = footprint_of(triangles_of((0.0, 1.0), (2.0, 0.0), (0.0, -1.0), (-2.0, 0.0), (0.5, 0.1), (1.0, 0.5)))
    assert set(found) == {(0.0, 1.0), (2.0, 0.0), (0.0, -1.0), (-2.0, 0.0)}
    area = sum(a[0] * b[1] - b[0] * a[1] for a, b in zip(found, (*found[1:], found[0]), strict=True)) / 2
    assert area == pytest.approx(4.0)


def test_a_board_without_thickness_has_two_vertices_and_a_pole_has_one_vertex() -> None:
    assert set(footprint_of(triangles_of((1.0, 0.0), (1.0, 2.0), (1.0, 0.5)))) == {(1.0, 0.0), (1.0, 2.0)}
    assert footprint_of(triangles_of((1.0, 0.5), (1.0, 0.5), (1.0, 0.5))) == ((1.0, 0.5),)


def test_a_round_object_keeps_its_extent_with_at_most_64_vertices() -> None:
    angles = np.linspace(0, 2 * math.pi, 720, endpoint=False)
    rim = [(math.cos(angle), math.sin(angle)) for angle in angles]
    found = footprint_of(triangles_of(*rim))
    assert len(found) == 64
    assert footprint_distances(rim, found).max() < 0.003


def test_every_vertex_of_an_object_is_inside_its_footprint() -> None:
    cloud = np.random.default_rng(7).normal(size=(400, 3, 3))
    found = footprint_of(cloud)
    assert footprint_distances(cloud.reshape(-1, 3)[:, :2], found).max() < 1e-4
