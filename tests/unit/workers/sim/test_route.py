"""Distance of the poses of an episode from the planner's path of the start."""

from __future__ import annotations

import numpy as np
import pytest

from workers.sim.correct import _distances_to


def test_the_distance_is_that_to_the_nearest_segment() -> None:
    line = np.array([(0.0, 0.0), (2.0, 0.0), (2.0, 0.0), (2.0, 2.0)])
    points = np.array([(1.0, 0.5), (2.5, 1.0), (-3.0, 4.0), (2.0, 0.0)])
    assert _distances_to(line, points) == pytest.approx([0.5, 0.5, 5.0, 0.0])


def test_a_path_of_one_point_is_a_point() -> None:
    assert _distances_to(np.array([(1.0, 1.0)]), np.array([(4.0, 5.0)])) == pytest.approx([5.0])
