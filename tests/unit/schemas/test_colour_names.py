"""Colour names match human naming."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.colors import XKCD_COLORS, to_rgb

from schemas.appearance.colour_names import dominant_name, lab_of, linear_of, name_indices, srgb_of
from schemas.terms import COLOUR_NAMES


@pytest.mark.parametrize(
    ("rgb", "name"),
    [
        ((0, 0, 0), "black"),
        ((40, 40, 42), "black"),
        ((58, 60, 64), "black"),
        ((128, 128, 128), "gray"),
        ((211, 211, 211), "gray"),
        ((255, 255, 255), "white"),
        ((245, 245, 220), "white"),
        ((255, 0, 0), "red"),
        ((139, 0, 0), "red"),
        ((255, 140, 0), "orange"),
        ((255, 255, 0), "yellow"),
        ((240, 200, 20), "yellow"),
        ((0, 128, 0), "green"),
        ((34, 139, 34), "green"),
        ((0, 0, 255), "blue"),
        ((70, 130, 180), "blue"),
        ((0, 0, 128), "blue"),
        ((128, 0, 128), "purple"),
        ((255, 192, 203), "pink"),
        ((139, 69, 19), "brown"),
        ((210, 104, 24), "orange"),  # orange paint on cloth
        ((194, 153, 107), "brown"),
        ((222, 190, 140), "brown"),
        ((225, 203, 168), "brown"),
        ((240, 220, 130), "yellow"),
        ((1, 21, 62), "blue"),
        ((28, 43, 82), "blue"),
        ((6, 46, 3), "green"),
        ((42, 1, 52), "purple"),
        ((101, 0, 33), "red"),
        ((255, 2, 141), "pink"),
    ],
)
def test_reference_colours_have_their_names(rgb: tuple[int, int, int], name: str) -> None:
    assert COLOUR_NAMES[int(name_indices(np.array(rgb) / 255))] == name


def survey() -> tuple[np.ndarray, list[str]]:
    """Returns the XKCD survey colours (N, 3), 0..1, whose names end in their only basic term, and these terms."""
    basic = {"grey": "gray", "navy": "blue", "maroon": "red"} | {name: name for name in COLOUR_NAMES}
    rows = {}
    for name, code in XKCD_COLORS.items():
        words = name.removeprefix("xkcd:").replace("/", " ").split()
        terms = {basic[word] for word in words if word in basic}
        if words[-1] in basic and len(terms) == 1:
            rows[code] = terms.pop()
    return np.array([to_rgb(code) for code in rows]), list(rows.values())


def named(srgb: np.ndarray) -> list[str]:
    return [(*COLOUR_NAMES, "unknown")[index] for index in name_indices(srgb)]


def test_most_colours_of_the_xkcd_survey_have_their_surveyed_names() -> None:
    srgb, expected = survey()
    hits = [found == name for found, name in zip(named(srgb), expected, strict=True)]
    assert len(hits) > 300
    assert np.mean(hits) > 0.8
    assert np.mean(np.array(hits)[lab_of(srgb)[:, 0] < 30]) > 0.9


def test_no_surveyed_hue_is_called_black_however_dark() -> None:
    srgb, expected = survey()
    hues = [(name, found) for name, found in zip(expected, named(srgb), strict=True) if name not in {"black", "gray"}]
    assert len(hues) > 300
    assert [pair for pair in hues if pair[1] == "black"] == []


def test_a_black_with_a_trace_of_a_hue_is_neither_black_nor_named_by_the_hue() -> None:
    assert named(np.array([[30, 35, 48], [20, 20, 40]]) / 255) == ["unknown", "blue"]
    assert dominant_name([(30 / 255, 35 / 255, 48 / 255)] * 9) == "unknown"


def test_a_colour_name_needs_at_least_half_of_the_samples() -> None:
    red, blue, green = (1.0, 0, 0), (0, 0, 1.0), (0, 0.5, 0)
    assert dominant_name([red, red, blue, green]) == "red"
    assert dominant_name([red, red, blue, green, blue]) == "unknown"


def test_an_object_of_two_colours_has_no_colour_name() -> None:
    red, blue = (1.0, 0, 0), (0, 0, 1.0)
    assert dominant_name([red] * 6 + [blue] * 4) == "unknown"
    assert dominant_name([red] * 7 + [blue] * 3) == "red"


def test_a_blue_chair_on_a_black_base_is_blue() -> None:
    blue, black = (0.1, 0.3, 0.7), (0.1, 0.1, 0.1)
    assert dominant_name([blue] * 55 + [black] * 45) == "blue"
    assert dominant_name([blue] * 45 + [black] * 55) == "unknown"


def test_an_object_with_similar_shares_of_black_and_gray_has_no_colour_name() -> None:
    black, gray = (0.1, 0.1, 0.1), (0.5, 0.5, 0.5)
    assert dominant_name([gray] * 58 + [black] * 42) == "unknown"
    assert dominant_name([gray] * 70 + [black] * 30) == "gray"


def test_teal_is_neither_green_nor_blue() -> None:
    assert dominant_name([(31 / 255, 127 / 255, 130 / 255)]) == "unknown"


def test_an_object_without_samples_has_no_colour() -> None:
    assert dominant_name(np.zeros((0, 3))) == "unknown"


def test_the_conversions_between_linear_light_and_srgb_are_inverse() -> None:
    values = np.linspace(0, 1, 11)
    assert srgb_of(linear_of(values)) == pytest.approx(values)


def test_white_has_lightness_100_and_no_chroma() -> None:
    assert lab_of((1.0, 1.0, 1.0)) == pytest.approx([100, 0, 0], abs=0.01)
