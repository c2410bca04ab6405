"""Division of a floor into rooms: rooms tile the floor, suit their specs and can all be entered."""

from __future__ import annotations

import numpy as np
import pytest

from factory.scenes.author.partition import Division, Doors, RoomSpec, divide_floor
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
    division = divide_floor(np.random.default_rng(seed), floor, SPECS, Doors(), hall_m)
    assert sum(area.width * area.depth for area in division.areas) == pytest.approx(floor.width * floor.depth)
    rooms = range(len(division.areas))
    assert not any(division.areas[i].grown(-1e-6).overlaps(division.areas[j]) for i in rooms for j in rooms if i != j)
    assert entered_from(division, 0) == set(rooms)
    for spec, area in zip(division.specs, division.areas, strict=True):
        assert min(area.width, area.depth) >= spec.least_m - 1e-9


@pytest.mark.parametrize("seed", range(5))
def test_no_bedroom_or_bath_is_entered_from_another_one(seed: int) -> None:
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


def test_a_floor_without_room_for_its_rooms_raises_with_its_size() -> None:
    with pytest.raises(WorldError, match=r"5\.0 x 4\.0 m into 5 rooms.*another seed"):
        divide_floor(np.random.default_rng(0), Rectangle(0.0, 0.0, 5.0, 4.0), SPECS, Doors())
