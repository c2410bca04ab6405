"""Colours are legible on both backgrounds, distinguishable with colour vision deficiency, and replaceable by name."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from numpy.typing import NDArray

from factory.html.palette import COLOURS, DASHES, TIER_COLOURS, TIER_MARKERS, scene_colours, with_variables
from schemas.terms import BUILTIN_CATEGORIES

# Machado, Oliveira and Fernandes (2009), severity 1.0, on linear RGB
_BLIND = {
    "protan": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "deutan": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
    "tritan": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]],
}
_GROUNDS = (0, 1)


def linear(code: str) -> NDArray[np.float64]:
    rgb = np.array([int(code[place : place + 2], 16) for place in (1, 3, 5)]) / 255
    return np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)


def lab(rgb: NDArray[np.float64]) -> NDArray[np.float64]:
    xyz = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]) @ rgb
    cube = np.cbrt(np.clip(xyz / (0.9505, 1.0, 1.089), 0.008856, None))
    return np.array([116 * cube[1] - 16, 500 * (cube[0] - cube[1]), 200 * (cube[1] - cube[2])])


def contrast(one: str, other: str) -> float:
    weights = np.array([0.2126, 0.7152, 0.0722])
    low, high = sorted(float(weights @ linear(code)) for code in (one, other))
    return (high + 0.05) / (low + 0.05)


def test_no_two_names_share_a_colour_on_a_light_background() -> None:
    assert len({light for light, _ in COLOURS.values()}) == len(COLOURS)


@pytest.mark.parametrize("ground", _GROUNDS)
def test_text_has_the_contrast_that_wcag_requires(ground: int) -> None:
    for name in ("ink", "muted", "paper"):
        assert contrast(COLOURS[name][ground], COLOURS["card"][ground]) >= 4.5, name


@pytest.mark.parametrize("ground", _GROUNDS)
def test_marks_have_the_contrast_that_wcag_requires(ground: int) -> None:
    names = [*TIER_COLOURS.values(), "scene1", "scene2", "scene3", "scene4", "won", "collision"]
    poor = {name: contrast(COLOURS[name][ground], COLOURS["card"][ground]) for name in names}
    assert not {name: ratio for name, ratio in poor.items() if ratio < 2.7}


@pytest.mark.parametrize("ground", _GROUNDS)
@pytest.mark.parametrize("kind", sorted(_BLIND))
def test_tiers_differ_for_people_with_colour_vision_deficiency(kind: str, ground: int) -> None:
    seen = [
        lab(np.clip(np.array(_BLIND[kind]) @ linear(COLOURS[name][ground]), 0, 1)) for name in TIER_COLOURS.values()
    ]
    assert min(float(np.linalg.norm(one - other)) for one, other in itertools.combinations(seen, 2)) > 15


def test_scenes_and_tiers_differ_without_any_colour() -> None:
    assert len(set(TIER_MARKERS.values())) == len(TIER_MARKERS)
    assert len(set(DASHES)) >= len(BUILTIN_CATEGORIES)


def test_the_position_of_a_scene_determines_its_colour_and_colours_repeat_after_eight_scenes() -> None:
    found = scene_colours([f"s{n}" for n in range(9)])
    assert len(set(found.values())) == 8
    assert found["s0"] == found["s8"] == COLOURS["scene1"][0]


def test_drawings_use_the_colours_of_the_page() -> None:
    light = COLOURS["near"][0]
    assert with_variables(f'<path style="fill: {light}; stroke: #123456"/>') == (
        '<path style="fill: var(--near); stroke: #123456"/>'
    )
