"""Observations whose images are rendered when they are read: every way of reading gives the rendered images."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from factory.eval.driving.lazy_input import LazyInput
from schemas.errors import WorldError
from schemas.frame import Frame

FRAME = Frame(np.full((4, 4, 3), 7, np.uint8), np.full((4, 4), 1.5, np.float32), np.ones((4, 4), np.uint16))


def make() -> tuple[LazyInput, list[int]]:
    calls: list[int] = []

    def render() -> Frame:
        calls.append(1)
        return FRAME

    return LazyInput({"instruction": "Go.", "step": 3}, render), calls


WAYS: list[Callable[[LazyInput], dict[str, Any]]] = [
    dict,
    lambda seen: {**seen},
    lambda seen: dict(**seen),
    lambda seen: {key: seen[key] for key in seen},
    lambda seen: dict(seen.items()),
    lambda seen: dict(zip(seen.keys(), seen.values(), strict=True)),
    lambda seen: {key: seen.get(key) for key in seen},
    lambda seen: {key: seen.pop(key) for key in list(seen)},
    lambda seen: seen.copy(),
    copy.copy,
    copy.deepcopy,
    lambda seen: pickle.loads(pickle.dumps(seen)),
    lambda seen: seen | {},
    lambda seen: {} | seen,
]


@pytest.mark.parametrize("number", range(len(WAYS)))
def test_every_way_of_reading_gives_the_images_and_renders_once(number: int) -> None:
    seen, calls = make()
    read = WAYS[number](seen)
    assert set(read) == {"instruction", "step", "rgb", "depth"}
    assert (read["instruction"], read["step"]) == ("Go.", 3)
    np.testing.assert_array_equal(read["rgb"], FRAME.rgb)
    np.testing.assert_array_equal(read["depth"], FRAME.depth)
    assert len(calls) == 1


def test_reading_other_values_renders_nothing() -> None:
    seen, calls = make()
    assert (seen["step"], seen.get("instruction"), seen.get("pose"), "rgb" in seen, len(seen)) == (
        3,
        "Go.",
        None,
        True,
        4,
    )
    assert set(seen) == {"instruction", "step", "rgb", "depth"}
    assert calls == []


def test_a_changed_image_is_kept() -> None:
    seen, _ = make()
    seen["rgb"] = "mine"
    assert (seen["rgb"], dict(seen)["rgb"]) == ("mine", "mine")


def test_an_error_of_the_renderer_is_known() -> None:
    def render() -> Frame:
        raise WorldError("the renderer died")

    seen = LazyInput({}, render)
    with pytest.raises(WorldError):
        seen["rgb"]
    assert isinstance(seen.failure, WorldError)
