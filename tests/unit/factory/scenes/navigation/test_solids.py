"""Floor, collider and occupancy of a scene."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from factory.scenes.importer import Part, Surface
from factory.scenes.navigation.collider import solid_triangles, weld
from factory.scenes.navigation.floor import find_floor_height, floor_triangles
from factory.scenes.navigation.occupancy import GridFrame, build_occupancy, draw_band
from schemas.errors import WorldError
from schemas.support.numpy_types import Floats

FRAME = GridFrame((0.0, 0.0), 0.05, (40, 40))
_FACES = [(0, 2, 1), (0, 3, 2), (4, 5, 6), (4, 6, 7), (0, 1, 5), (0, 5, 4)]
_FACES += [(1, 2, 6), (1, 6, 5), (2, 3, 7), (2, 7, 6), (3, 0, 4), (3, 4, 7)]


def box(low: tuple[float, float, float], high: tuple[float, float, float]) -> Floats:
    (x0, y0, z0), (x1, y1, z1) = low, high
    flat = [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]
    corners = np.array([(x, y, z) for z in (z0, z1) for x, y in flat])
    return corners[np.array(_FACES)]


def part(path: str, triangles: Floats, is_collider: bool = False) -> Part:
    return Part(path, triangles, None, None, Surface(), is_collider)


def test_the_floor_is_the_lowest_large_level() -> None:
    scene = np.concatenate(
        [box((0, 0, -0.2), (10, 10, 0.1)), box((0, 0, 2.5), (10, 10, 2.7)), box((1, 1, 0.1), (2, 2, 0.8))]
    )
    assert find_floor_height(scene) == pytest.approx(0.1)


def test_a_cellar_hatch_is_not_the_floor() -> None:
    scene = np.concatenate([box((0, 0, -0.2), (10, 10, 0)), box((3, 3, -3), (4, 4, -2.9))])
    assert find_floor_height(scene) == pytest.approx(0.0)


def test_a_scene_without_floor_is_refused() -> None:
    wall = box((0, 0, 0), (10, 0.1, 3))
    with pytest.raises(WorldError, match="no floor"):
        find_floor_height(wall)


def test_floor_triangles_face_up_at_the_floors_height() -> None:
    found = floor_triangles(box((0, 0, -0.2), (10, 10, 0)), 0.0)
    assert len(found) == 2
    assert (found[:, :, 2] == 0).all()


def test_floor_and_ceiling_are_not_solid() -> None:
    floor, lamp = box((0, 0, -0.1), (10, 10, 0.0)), box((1, 1, 2.3), (2, 2, 2.4))
    crate = box((1, 1, 0), (2, 2, 1))
    solid = solid_triangles([part("/a", floor), part("/b", lamp), part("/c", crate)], [], 0.0)
    assert solid.min(axis=(0, 1)).tolist() == [1, 1, 0]
    assert solid.max(axis=(0, 1)).tolist() == [2, 2, 1]


def test_an_authored_collider_replaces_the_meshes_inside_it() -> None:
    shown = part("/World/Shelf/visual", box((0, 0, 0), (1, 1, 1)))
    beside = part("/World/Crate/visual", box((3, 0, 0), (4, 1, 1)))
    proxy = part("/World/Shelf/collision", box((0, 0, 0), (0.2, 1, 1)), is_collider=True)
    far = part("/World/Shelf/collision_2", box((0.9, 0, 0), (1, 1, 1)), is_collider=True)
    solid = solid_triangles([shown, beside], [proxy, far], 0.0)
    assert len(solid) == 3 * 10  # of each box, the 2 triangles on the floor count as floor
    assert not ((solid[:, :, 0] > 0.2) & (solid[:, :, 0] < 0.9)).any()


def test_a_collider_that_covers_too_little_replaces_no_mesh() -> None:
    shown = part("/World/Shelf/visual", box((0, 0, 0), (1, 1, 1)))
    proxy = part("/World/Shelf/collision", box((0, 0, 0), (0.2, 1, 1)), is_collider=True)
    assert len(solid_triangles([shown], [proxy], 0.0)) == 20


def test_weld_joins_corners_and_drops_duplicate_and_degenerate_triangles() -> None:
    cube = box((0, 0, 0), (1, 1, 1))
    sliver = np.zeros((1, 3, 3))
    vertices, faces = weld(np.concatenate([cube, cube[:, ::-1], sliver]))
    assert vertices.shape == (8, 3)
    assert faces.shape == (12, 3)
    assert vertices.dtype == np.float32


def test_weld_of_no_triangles_is_empty() -> None:
    vertices, faces = weld(np.zeros((0, 3, 3)))
    assert vertices.shape == (0, 3)
    assert faces.shape == (0, 3)


def cells_of(triangles: Floats) -> NDArray[np.bool_]:
    return draw_band(triangles, 0.0, (0.05, 0.60), FRAME)


def test_a_crate_fills_its_cells() -> None:
    cells = cells_of(box((0.51, 0.51, 0), (0.99, 0.99, 0.4)))
    rows, columns = np.nonzero(cells)
    assert (rows.min(), rows.max(), columns.min(), columns.max()) == (10, 19, 10, 19)
    assert cells.sum() == 100


def test_only_the_outline_of_a_tall_pillar_is_occupied() -> None:
    cells = cells_of(box((0.51, 0.51, -1), (0.99, 0.99, 3)))
    assert cells.sum() == 36


def test_geometry_outside_the_height_band_is_free() -> None:
    assert not cells_of(box((0.5, 0.5, 0.61), (1, 1, 2))).any()
    assert not cells_of(box((0.5, 0.5, -1), (1, 1, 0.04))).any()


def test_a_ramp_counts_only_where_it_is_in_the_band() -> None:
    ramp = np.array(
        [[(0.0, 0.5, 0.0), (2.0, 0.5, 1.0), (2.0, 1.5, 1.0)], [(0, 0.5, 0), (2, 1.5, 1), (0, 1.5, 0)]], float
    )
    columns = np.flatnonzero(cells_of(ramp).any(axis=0))
    assert (columns.min(), columns.max()) == (2, 23)


def test_thin_posts_are_rasterised() -> None:
    assert cells_of(box((0.521, 0.521, 0), (0.522, 0.522, 2))).sum() == 1


def test_walls_block_sight_and_tables_do_not_and_cells_off_the_floor_are_occupied() -> None:
    floor = box((0, 0, -0.1), (4, 4, 0))
    wall, bench = box((1, 1, 0), (1.2, 3, 2.5)), box((3, 1, 0), (3.4, 3, 0.5))
    frame, grid = build_occupancy(np.concatenate([wall, bench]), np.concatenate([floor, wall, bench]), 0.0)
    row, column = (np.array([2.025, 1.025]) - frame.origin_m[::-1]) / 0.05
    assert grid[int(row), int(column)] == 2
    assert grid[int(row), int(column + 42)] == 1
    assert grid[0, 0] == 1
    assert grid[int(row), int(column - 10)] == 0


def test_a_floor_too_large_for_a_grid_is_refused() -> None:
    floor = box((0, 0, -0.1), (900, 900, 0))
    posts = np.concatenate([box((0, 0, 0), (1, 1, 1)), box((899, 899, 0), (900, 900, 1))])
    with pytest.raises(WorldError, match="metersPerUnit"):
        build_occupancy(posts, np.concatenate([floor, posts]), 0.0)
