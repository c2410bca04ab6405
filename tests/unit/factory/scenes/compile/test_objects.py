"""Every part belongs to one object, and ids follow the order of the paths."""

from __future__ import annotations

import numpy as np

from factory.scenes.compile.objects import assign_objects, number_objects
from factory.scenes.importer import Part, Surface


def parts(*paths: str) -> list[Part]:
    return [Part(path, np.zeros((1, 3, 3)), None, None, Surface()) for path in paths]


def test_objects_have_priority_over_models_and_models_over_prims() -> None:
    found = assign_objects(
        parts("/W/Room/Chair/Seat", "/W/Room/Lamp/Bulb", "/W/Floor", "/W/Room/Chair2/Seat"),
        things=["/W/Room/Chair"],
        models=["/W/Room/Lamp", "/W/Room/Chair"],
    )
    assert found == ("/W/Room/Chair", "/W/Room/Lamp", "/W/Floor", "/W/Room/Chair2/Seat")


def test_the_outermost_model_is_the_object() -> None:
    assert assign_objects(parts("/W/Car/Wheel/Tyre"), [], ["/W/Car", "/W/Car/Wheel"]) == ("/W/Car",)


def test_ids_follow_the_order_of_the_paths() -> None:
    assert number_objects(["/b", "/a", "/b", "/c"]) == {"/a": 1, "/b": 2, "/c": 3}


def test_too_many_prims_are_merged_into_their_parents_except_targets() -> None:
    many = [f"/W/Grass/Blade_{number}" for number in range(70000)]
    owners = assign_objects(parts("/W/Chair/Seat", *many), things=["/W/Chair"], models=[])
    assert set(owners) == {"/W/Chair", "/W/Grass"}
