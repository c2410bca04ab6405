"""Charts and their rectangles in the light map."""

from __future__ import annotations

import numpy as np
import pytest

from factory.scenes.light.charts import Charts, TooManyPieces, Unwrap, find_charts, interpolate, unwrap
from tests.builders.scene import Box, box_room
from tests.builders.solids import box_triangles


def charts_of(*boxes: Box) -> Charts:
    return find_charts(box_triangles(boxes), np.repeat(np.arange(len(boxes)), 12))


def room_charts() -> Charts:
    scene = box_room()
    return find_charts(scene.positions.reshape(-1, 3, 3).astype(float), np.repeat(np.arange(len(scene.part_count)), 12))


def covered(layout: Unwrap) -> np.ndarray:
    """Number of charts that use each texel."""
    claims = np.zeros(layout.shape, int)
    for (column, row), (wide, high) in zip(layout.place, layout.size, strict=True):
        claims[row : row + high, column : column + wide] += 1
    return claims


def test_a_box_has_six_charts_with_the_sizes_of_its_faces() -> None:
    charts = charts_of(Box((0, 0, 0), (3, 2, 1)))
    assert len(charts.area) == 6
    assert sorted(charts.extent.prod(axis=1).round(6)) == sorted([2, 2, 3, 3, 6, 6])
    assert charts.area == pytest.approx(charts.extent.prod(axis=1))


def test_a_turned_box_has_charts_no_larger_than_its_faces() -> None:
    turn = np.array([[0.8, -0.6, 0], [0.6, 0.8, 0], [0, 0, 1]])
    charts = find_charts(box_triangles([Box((0, 0, 0), (3, 2, 1))]) @ turn.T, np.zeros(12, np.int64))
    assert charts.area == pytest.approx(charts.extent.prod(axis=1))


def test_corners_are_interpolated_between_the_anchors_of_their_chart() -> None:
    roof = np.array([[(0, 0, 1), (2, 0, 1), (1, 1, 2)]], float)
    taper = np.array([[(0, 0, 5), (4, 0, 5), (3, 1, 5)], [(0, 0, 5), (3, 1, 5), (1, 1, 5)]], float)
    triangles = np.concatenate((box_triangles([Box((1, 2, 3), (4, 4, 4))]), roof, taper))
    charts = find_charts(triangles, np.zeros(len(triangles), np.int64))
    chart = np.repeat(charts.of_triangle, 3)
    again = interpolate(charts.anchors, chart, charts.share.reshape(-1, 1, 2))
    assert again.reshape(-1, 3, 3) == pytest.approx(triangles)


@pytest.mark.parametrize("turn", range(3))
def test_a_tapered_face_is_mapped_corner_by_corner_however_it_is_divided(turn: int) -> None:
    faces = ([(0, 0, 5), (4, 0, 5), (3, 1, 5)], [(0, 0, 5), (3, 1, 5), (1, 1, 5)])
    triangles = np.array([np.roll(face, turn + number, axis=0) for number, face in enumerate(faces)], float)
    charts = find_charts(triangles, np.zeros(2, np.int64))
    assert sorted(charts.anchors[0].tolist()) == [[0, 0, 5], [1, 1, 5], [3, 1, 5], [4, 0, 5]]
    assert set(map(tuple, charts.share.reshape(-1, 2).tolist())) == {(0, 0), (1, 0), (1, 1), (0, 1)}


def test_different_groups_and_distant_faces_of_one_plane_are_not_joined() -> None:
    beside, apart = Box((1, 0, 0), (2, 1, 1)), Box((5, 0, 0), (6, 1, 1))
    assert len(charts_of(Box((0, 0, 0), (1, 1, 1)), beside).area) == 12
    both = box_triangles([beside, apart])
    assert len(find_charts(both, np.zeros(len(both), np.int64)).area) == 12


def test_degenerate_triangles_are_accepted() -> None:
    charts = find_charts(np.zeros((2, 3, 3)), np.zeros(2, np.int64))
    assert np.isfinite(charts.axes).all()
    assert np.isfinite(unwrap(charts).uvs).all()


def test_charts_do_not_overlap_and_are_inside_the_map() -> None:
    layout = unwrap(room_charts())
    assert covered(layout).max() == 1
    assert covered(layout).sum() == layout.size.prod(axis=1).sum()
    assert (layout.uvs.min() > 0, layout.uvs.max() < 1) == (True, True)


def test_bilinear_sampling_stays_within_the_chart() -> None:
    charts = room_charts()
    layout = unwrap(charts)
    texel = layout.uvs * (layout.shape[1], layout.shape[0])
    low = layout.place[charts.of_triangle][:, None] + 0.5
    high = low + layout.size[charts.of_triangle][:, None] - 1
    assert ((texel >= low - 1e-9) & (texel <= high + 1e-9)).all()


def test_an_overfull_map_gets_coarser_texels() -> None:
    charts = room_charts()
    fine, coarse = unwrap(charts), unwrap(charts, width=128, max_height=128)
    assert coarse.shape[0] <= 128
    assert coarse.size.prod(axis=1).sum() < fine.size.prod(axis=1).sum()
    assert covered(coarse).max() == 1


def test_more_pieces_than_texels_are_refused() -> None:
    with pytest.raises(TooManyPieces, match="do not fit"):
        unwrap(room_charts(), width=2, max_height=2)


def test_pieces_that_need_two_texels_get_one_in_a_full_map() -> None:
    charts = room_charts()
    least = np.full((len(charts.area), 2), 2)
    count = len(charts.area)
    layout = unwrap(charts, least=least, width=64, max_height=-(-count // 64) + 1)
    assert layout.shape[0] <= -(-count // 64) + 1
    assert layout.size.min() == 1
    assert covered(layout).max() == 1
    assert (unwrap(charts, least=least).size >= 2).all()
