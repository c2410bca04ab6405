"""Arrangements of halls: blocks and halls tile their outline, rows have the desired rooms, halls meet without walls."""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations

import numpy as np
import pytest

from factory.scenes.author.circulation import (
    HALL,
    SLENDER,
    Arrangement,
    RoomSpec,
    Scheme,
    l_hall,
    ring_hall,
    row_widths,
    spine_hall,
    t_hall,
)
from factory.scenes.author.partition import Doors, divide_floor
from factory.scenes.author.placement import Rectangle

FLOOR = Rectangle(2.0, -3.0, 22.0, 13.0)
SPECS = (
    RoomSpec("open", 60.0, 5.2, True),
    RoomSpec("open", 50.0, 5.2, True),
    *(RoomSpec("private", area, 3.1) for area in (14.0, 15.0, 17.0, 16.0)),
    *(RoomSpec("meeting", area, 3.6) for area in (20.0, 26.0)),
    RoomSpec("kitchen", 22.0, 3.3),
    RoomSpec("wash", 12.0, 2.6),
)
SCHEMES = {"spine": spine_hall, "t": t_hall, "l": l_hall, "ring": ring_hall}
HALLS = {"spine": 1, "t": 2, "l": 2, "ring": 4}


def arranged(scheme: Scheme) -> Arrangement:
    """Returns the first arrangement that the scheme finds."""
    rng = np.random.default_rng(0)
    tries = (scheme(rng, FLOOR, SPECS) for _ in range(400))
    return next(found for found in tries if found is not None)


@pytest.mark.parametrize("name", SCHEMES)
def test_blocks_and_halls_do_not_overlap_and_have_all_rooms(name: str) -> None:
    found = arranged(SCHEMES[name](2.0))
    areas = [*(block.area for block in found.blocks), *found.halls]
    assert not any(one.grown(-1e-6).overlaps(two) for one, two in combinations(areas, 2))
    assert sorted(spec for block in found.blocks for spec in block.specs) == sorted(SPECS)
    assert len(found.halls) == HALLS[name]
    assert all(min(hall.width, hall.depth) == pytest.approx(2.0) for hall in found.halls)


@pytest.mark.parametrize("name", SCHEMES)
def test_only_an_l_leaves_a_corner_of_the_outline_empty(name: str) -> None:
    found = arranged(SCHEMES[name](2.0))
    areas = [*(block.area for block in found.blocks), *found.halls]
    x0, y0, x1, y1 = (pick(area[side] for area in areas) for side, pick in enumerate((min, min, max, max)))
    share = sum(area.width * area.depth for area in areas) / ((x1 - x0) * (y1 - y0))
    assert share == pytest.approx(1.0) if name != "l" else 0.4 < share < 0.9


@pytest.mark.parametrize("name", SCHEMES)
@pytest.mark.parametrize("seed", range(6))
def test_every_room_is_entered_from_a_hub_and_parts_of_a_hall_meet_over_their_whole_width(name: str, seed: int) -> None:
    division = divide_floor(np.random.default_rng(seed), FLOOR, SPECS, Doors(), SCHEMES[name](2.0))
    entered = {room for opening in division.openings for room in opening.rooms}
    assert entered == set(range(len(division.areas)))
    joints = [opening for opening in division.openings if opening.is_joint]
    assert len(joints) == {1: 0, 2: 1, 4: 4}[HALLS[name]]
    for opening in division.openings:
        kinds = [division.specs[room].kind for room in opening.rooms]
        assert opening.is_joint == (kinds == [HALL, HALL])
        assert not opening.is_joint or opening.doorway.width == pytest.approx(2.0)


def test_a_row_fills_its_block_with_rooms_of_permitted_proportions() -> None:
    area, specs = Rectangle(0.0, 0.0, 16.0, 4.6), SPECS[2:6]
    widths = row_widths(area, specs)
    assert widths is not None
    assert sum(widths) == pytest.approx(16.0)
    for width, spec in zip(widths, specs, strict=True):
        assert width >= max(spec.least_m, 4.6 / SLENDER) - 1e-9
        assert width <= SLENDER * 4.6


@pytest.mark.parametrize(
    ("area", "reason"),
    [
        (Rectangle(0.0, 0.0, 9.0, 4.6), "too short"),
        (Rectangle(0.0, 0.0, 60.0, 4.6), "too long"),
        (Rectangle(0.0, 0.0, 16.0, 3.0), "less deep than a room"),
        (Rectangle(0.0, 0.0, 30.0, 8.5), "rooms of twice the desired floor"),
    ],
)
def test_rooms_that_do_not_fit_into_a_row_get_no_widths(area: Rectangle, reason: str) -> None:
    assert row_widths(area, SPECS[2:6]) is None, reason


def test_a_scheme_returns_none_for_rooms_that_do_not_fit_into_rows() -> None:
    scheme: Callable[[float], Scheme] = ring_hall
    assert scheme(2.0)(np.random.default_rng(0), FLOOR, SPECS[:1]) is None
