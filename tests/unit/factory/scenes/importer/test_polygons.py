"""Triangulation keeps area, winding and faces."""

from __future__ import annotations

import numpy as np
import pytest

from factory.scenes.importer.polygons import is_closed, triangulate

L_SHAPE = np.array([(0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)], float)
STAR = np.array([(r * np.cos(a), r * np.sin(a)) for a, r in zip(np.arange(10) * np.pi / 5, [2, 0.7] * 5, strict=True)])


def signed_areas(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    a, b, c = (points[corners[:, k]] for k in range(3))
    return np.cross(b - a, c - a)[:, 2] / 2


def polygon_area(flat: np.ndarray) -> float:
    x, y = flat.T
    return float((x * np.roll(y, -1) - np.roll(x, -1) * y).sum() / 2)


@pytest.mark.parametrize("flat", [L_SHAPE, STAR, L_SHAPE[::-1]], ids=["l_shape", "star", "clockwise"])
def test_concave_polygons_keep_area_and_winding(flat: np.ndarray) -> None:
    points = np.column_stack([flat, np.zeros(len(flat))])
    cut = triangulate(points, np.array([len(flat)]), np.arange(len(flat)))
    areas = signed_areas(points, cut.corners)
    assert areas.sum() == pytest.approx(polygon_area(flat))
    assert (np.sign(areas) == np.sign(polygon_area(flat))).all()


def test_triangles_stay_in_the_order_of_their_faces() -> None:
    points = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (2, 0, 0)], float)
    cut = triangulate(points, np.array([4, 3, 2]), np.array([0, 1, 2, 3, 1, 4, 2, 0, 1]))
    assert cut.faces.tolist() == [0, 0, 1]
    assert cut.corners.tolist() == [[0, 1, 2], [0, 2, 3], [4, 5, 6]]


@pytest.mark.parametrize(("counts", "indices"), [([4], [0, 1, 2]), ([3], [0, 1, 9]), ([3], [0, 1, -1])])
def test_inconsistent_topology_is_refused(counts: list[int], indices: list[int]) -> None:
    with pytest.raises(ValueError, match="bad topology"):
        triangulate(np.eye(3), np.array(counts), np.array(indices))


def test_a_tetrahedron_is_closed_until_a_face_is_missing() -> None:
    faces = np.array([(0, 2, 1), (0, 1, 3), (1, 2, 3), (2, 0, 3)])
    assert is_closed(faces)
    assert not is_closed(faces[:3])
