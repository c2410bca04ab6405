"""Outlines of grid regions: they enclose exactly the cells, holes included."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray

from factory.visualize.floor_map import trace_outlines


def area(loop: NDArray[np.float64]) -> float:
    x, y = loop.T
    return float((x * np.roll(y, -1) - y * np.roll(x, -1)).sum() / 2)


def test_a_square_has_four_corners() -> None:
    mask = np.zeros((5, 6), bool)
    mask[1:4, 2:5] = True
    (loop,) = trace_outlines(mask)
    assert sorted(map(tuple, loop)) == [(2, 1), (2, 4), (5, 1), (5, 4)]


def test_a_hole_is_a_loop_in_the_other_direction() -> None:
    mask = np.ones((5, 5), bool)
    mask[2, 2] = False
    assert sorted(map(area, trace_outlines(mask))) == [-1, 25]


def test_an_empty_grid_has_no_outlines() -> None:
    assert trace_outlines(np.zeros((3, 3), bool)) == []


@given(arrays(bool, st.tuples(st.integers(1, 9), st.integers(1, 9))))
def test_loops_enclose_the_area_of_the_cells(mask: NDArray[np.bool_]) -> None:
    assert sum(map(area, trace_outlines(mask))) == mask.sum()
