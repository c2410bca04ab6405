"""Colours and markers of all figures and pages, for the light and the dark theme. Pure functions.

The palette follows Okabe and Ito for colour-blind readers; markers and dashes repeat the information.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from types import MappingProxyType

from schemas.terms import FailReason, Split, Tier

COLOURS: Mapping[str, tuple[str, str]] = MappingProxyType(
    {
        "card": ("#fffffe", "#1a1f27"),
        "ink": ("#1d2430", "#e6eaf0"),
        "muted": ("#596474", "#9eaab9"),
        "line": ("#dfe3e8", "#333b47"),
        "wall": ("#8b95a3", "#66728a"),
        "low": ("#ccd3db", "#3b4553"),
        "floor": ("#f2f4f6", "#222934"),
        "paper": ("#b0246a", "#f277b0"),
        "near": ("#c98a00", "#f0b93a"),
        "mid": ("#1f9a8a", "#3fc4b2"),
        "far": ("#5a48b5", "#a396ff"),
        "scene1": ("#2c74c9", "#62a4f2"),
        "scene2": ("#d8702a", "#f2955a"),
        "scene3": ("#158f68", "#3cc294"),
        "scene4": ("#a85bab", "#d48dd6"),
        "scene5": ("#8a7b1c", "#cbb945"),
        "scene6": ("#3aa6c4", "#6fd0ea"),
        "scene7": ("#9a4f3a", "#d4836b"),
        "scene8": ("#6b7480", "#a8b2bf"),
        "train": ("#3d6fa8", "#6fa3de"),
        "val": ("#7fa6d1", "#4c77a6"),
        "test": ("#1f9a89", "#3fc4b1"),
        "phrase": ("#d79a1c", "#edb94c"),
        "object": ("#c4532d", "#ee8560"),
        "place": ("#2f6f73", "#62b3b8"),
        "place_phrase": ("#8a6d1f", "#cbb05a"),
        "place_object": ("#9a4a6e", "#d58bb0"),
        "won": ("#3b7fc0", "#68a9ea"),
        "collision": ("#c5532c", "#ef8661"),
        "timeout": ("#d79b1d", "#eebb4e"),
        "spawn": ("#8b6fb0", "#b59add"),
        "no_path": ("#5f8f3f", "#93c46f"),
        "contact": ("#4f6d8f", "#84a5cb"),
        "not_in_view": ("#7d5a45", "#b08c74"),
        "no_view": ("#6b6f2a", "#a9ad5e"),
        "other": ("#858f9c", "#8b96a5"),
    }
)
"""Name -> colour of the light and of the dark theme; all colours of a theme are different."""

TIER_COLOURS = MappingProxyType({tier: str(tier) for tier in Tier})
TIER_MARKERS = MappingProxyType({Tier.NEAR: "o", Tier.MID: "^", Tier.FAR: "s"})
SPLIT_COLOURS = MappingProxyType(
    {
        Split.TRAIN_ID: "train",
        Split.VAL_ID: "val",
        Split.TEST_ID: "test",
        Split.TEST_PARAPHRASE_OOD: "phrase",
        Split.TEST_OOD_OBJ: "object",
        Split.TEST_UNSEEN_SCENE: "place",
        Split.TEST_UNSEEN_SCENE_PARAPHRASE_OOD: "place_phrase",
        Split.TEST_UNSEEN_SCENE_OOD_OBJ: "place_object",
        Split.TEST_FALSE_PREMISE: "other",
    }
)
REASON_COLOURS = MappingProxyType(
    {
        FailReason.COLLISION: "collision",
        FailReason.TIMEOUT: "timeout",
        FailReason.SPAWN: "spawn",
        FailReason.NO_PATH: "no_path",
        FailReason.CONTACT: "contact",
        FailReason.NOT_IN_VIEW: "not_in_view",
        FailReason.NO_VIEW: "no_view",
    }
)
DASHES = ((0, ()), (0, (5, 2)), (0, (1.5, 1.5)), (0, (6, 2, 1.5, 2)), (0, (9, 3)), (0, (1, 3)), (0, (3, 1, 1, 1, 1, 1)))
"""Line styles by scene, cyclic."""
_SCENE_COLOURS = tuple(name for name in COLOURS if name.startswith("scene"))
_BY_LIGHT = {light: name for name, (light, _) in COLOURS.items()}
_HEX = re.compile(r"#[0-9a-f]{6}\b")


def reason_colour(reason: str) -> str:
    return next((name for known, name in REASON_COLOURS.items() if known == reason), "other")


def colour(name: str) -> str:
    """Returns the colour of the light theme as `#rrggbb`."""
    return COLOURS[name][0]


def scene_colours(scenes: Sequence[str]) -> dict[str, str]:
    """Returns the colour of each scene by its index in the plan; colours repeat from the ninth scene."""
    return {scene: colour(_SCENE_COLOURS[place % len(_SCENE_COLOURS)]) for place, scene in enumerate(scenes)}


def css_variables(dark: bool) -> str:
    """Returns the CSS variables of all colours of the light or dark theme."""
    return " ".join(f"--{name}: {pair[dark]};" for name, pair in COLOURS.items())


def with_variables(svg: str) -> str:
    """Replaces the colours of the palette in an SVG by CSS variables, so it follows the theme of the page."""

    def replace(match: re.Match[str]) -> str:
        name = _BY_LIGHT.get(match.group())
        return f"var(--{name})" if name else match.group()

    return _HEX.sub(replace, svg)
