"""Cache of results that are computed from the grid of a scene."""

from __future__ import annotations

import gc
import weakref

import numpy as np

from workers.geometry.grid import Grid
from workers.planning.kept import kept_with_grid
from workers.planning.lattice import PoseTable, pose_table


class Result:
    """A result that supports weak references."""


def small_grid() -> Grid:
    return Grid(np.zeros((8, 9), np.uint8), (0.0, 0.0), 0.05)


def test_a_result_is_computed_once_for_each_grid_and_argument() -> None:
    computed: list[float] = []

    @kept_with_grid(2)
    def double(grid: Grid, number: float) -> float:
        computed.append(number)
        return 2 * number

    one, two = small_grid(), small_grid()
    assert [double(one, 1.0), double(one, 1.0), double(two, 1.0), double(one, 3.0)] == [2.0, 2.0, 2.0, 6.0]
    assert computed == [1.0, 1.0, 3.0]


def test_the_least_recently_used_result_is_freed_before_another_result_is_computed() -> None:
    alive: list[int] = []
    results: list[weakref.ref[Result]] = []

    @kept_with_grid(2)
    def result_of(grid: Grid, number: int) -> Result:
        alive.append(sum(result() is not None for result in results))
        made = Result()
        results.append(weakref.ref(made))
        return made

    grid = small_grid()
    for number in (1, 2, 1, 3):
        result_of(grid, number)
    assert alive == [0, 1, 1]
    assert [result() is not None for result in results] == [True, False, True]


def test_a_pose_table_is_freed_with_its_grid_without_the_garbage_collector() -> None:
    grid = small_grid()
    table: weakref.ref[PoseTable] = weakref.ref(pose_table(grid, 0.0))
    assert table() is pose_table(grid, 0.0)
    gc.disable()
    try:
        del grid
        assert table() is None
    finally:
        gc.enable()
