"""A stage is open where upward rays meet no visible face; tested with one-sided and double-sided faces."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from factory.scenes.compile.overhead import is_open

SPAWNS = np.array([(x, y) for x in (-2.0, 0.0, 2.0) for y in (-1.0, 1.0)], np.float32)


def hall(inwards: bool = True, roof: bool = True) -> NDArray[np.float64]:
    """Returns the triangles of a hall of 8 x 6 x 3 m whose faces are visible from inside or from outside."""
    corners = np.array([(x, y, z) for z in (0.0, 3.0) for y in (-3.0, 3.0) for x in (-4.0, 4.0)])
    faces = [(0, 1, 3, 2), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]  # seen from inside
    faces += [(4, 6, 7, 5)] if roof else []
    triangles = np.array([corners[[a, b, c, a, c, d]] for a, b, c, d in faces]).reshape(-1, 3, 3)
    return triangles if inwards else triangles[:, ::-1]


@pytest.mark.parametrize("order", [1, -1])
def test_double_sided_walls_close_a_stage_in_any_order_of_their_faces(order: int) -> None:
    both = [hall(), hall(inwards=False)][::order]
    assert not is_open(np.concatenate(both), SPAWNS, 0.0)
    assert is_open(np.concatenate([hall(roof=False), hall(inwards=False, roof=False)][::order]), SPAWNS, 0.0)


def test_faces_that_are_visible_only_from_outside_do_not_close_a_stage() -> None:
    assert not is_open(hall(), SPAWNS, 0.0)
    assert is_open(hall(inwards=False), SPAWNS, 0.0)
