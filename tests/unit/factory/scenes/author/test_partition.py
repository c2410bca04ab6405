"""Division of a floor into rooms: rooms tile the floor, suit their specs and can all be entered."""

from __future__ import annotations

import numpy as np
import pytest

from factory.scenes.author.circulation import RoomSpec, no_hall, straight_hall
from factory.scenes.author.partition import Division, Doors, divide_floor, turned
from factory.scenes.author.placement import Rectangle
from schemas.errors import WorldError

FLOOR = Rectangle(0.0, 0.0, 12.0, 9.0)
SPECS = (
    RoomSpec("living", 36.0, 4.2, True),
    RoomSpec("kitchen", 19.0, 3.1, True),
    RoomSpec("bedroom", 21.0, 3.4),
    RoomSpec("bedroom", 18.0, 3.2),
    RoomSpec("bath", 12.0, 2.5),
)


def entered_from(division: Division, room: int) -> set[int]:
    """Returns the rooms that can be entered from a room."""
    found = {room}
    while True:
        more = {end for opening in division.openings for end in opening.rooms if found & set(opening.rooms)}
        if more <= found:
            return found
        found |= more


@pytest.mark.parametrize("hall_m", [None, 1.8])
@pytest.mark.parametrize("seed", range(5))
def test_rooms_tile_the_floor_and_can_all_be_entered(seed: int, hall_m: float | None) -> None:
    floor = FLOOR if hall_m is None else FLOOR._replace(y1=FLOOR.y1 + hall_m)
    scheme = no_hall if hall_m is None else straight_hall(hall_m)
    division = divide_floor(np.random.default_rng(seed), floor, SPECS, Doors(), scheme)
    assert sum(area.width * area.depth for area in division.areas) == pytest.approx(floor.width * floor.depth)
    rooms = range(len(division.areas))
    assert not any(division.areas[i].grown(-1e-6).overlaps(division.areas[j]) for i in rooms for j in rooms if i != j)
    assert entered_from(division, 0) == set(rooms)
    for spec, area in zip(division.specs, division.areas, strict=True):
        assert min(area.width, area.depth) >= spec.least_m - 1e-9


@pytest.mark.parametrize("seed", range(5))
def test_no_bedroom_or_bath_is_entered_from_another_bedroom_or_bath(seed: int) -> None:
    division = divide_floor(np.random.default_rng(seed), FLOOR, SPECS, Doors())
    for opening in division.openings:
        assert any(division.specs[room].is_hub for room in opening.rooms)


def test_an_opening_is_within_the_common_wall_of_its_rooms() -> None:
    division = divide_floor(np.random.default_rng(3), FLOOR, SPECS, Doors(1.1))
    for opening in division.openings:
        half = opening.doorway.width / 2
        assert opening.doorway.width >= 1.1 - 1e-9
        for room in opening.rooms:
            area = division.areas[room]
            span = (area.x0, area.x1) if opening.is_along_x else (area.y0, area.y1)
            assert span[0] < opening.doorway.centre - half
            assert opening.doorway.centre + half < span[1]


def test_the_error_of_a_floor_that_is_too_small_for_its_rooms_states_its_size() -> None:
    with pytest.raises(WorldError, match=r"5\.0 x 4\.0 m into 5 rooms was found"):
        divide_floor(np.random.default_rng(0), Rectangle(0.0, 0.0, 5.0, 4.0), SPECS, Doors())


@pytest.mark.parametrize("seed", range(8))
def test_a_turned_division_has_the_same_rooms_and_openings_in_their_common_walls(seed: int) -> None:
    division = divide_floor(np.random.default_rng(1), FLOOR, SPECS, Doors())
    other = turned(np.random.default_rng(seed), division)
    for before, after in zip(division.areas, other.areas, strict=True):
        assert sorted((after.width, after.depth)) == pytest.approx(sorted((before.width, before.depth)))
    for opening in other.openings:
        centre, at = opening.doorway.centre, opening.at
        x, y = (centre, at) if opening.is_along_x else (at, centre)
        for room in opening.rooms:
            area = other.areas[room]
            edges = (area.y0, area.y1) if opening.is_along_x else (area.x0, area.x1)
            assert min(abs(at - edge) for edge in edges) < 1e-9
            assert area.x0 - 1e-9 <= x <= area.x1 + 1e-9
            assert area.y0 - 1e-9 <= y <= area.y1 + 1e-9
