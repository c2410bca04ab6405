"""Finds out whether a language file yields instructions in a scene, and if not, which features would. Opens no file."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from schemas.language.compose import Composer, composer_of
from schemas.language.expression import Family
from schemas.language.file import LanguageSpec
from schemas.language.graph.view import SceneView
from schemas.language.scene import SceneLanguage

Probe = tuple[int, SceneView]
"""Number of a target in the scene graph, and a view from a start."""


def explain_impossible(scene: SceneLanguage, spec: LanguageSpec, probes: Sequence[Probe]) -> str:
    """Returns why no probe gets an instruction, and which features are possible; empty if a probe gets an instruction.

    Args:
        scene: prepared scene.
        spec: content of the language file.
        probes: targets with starts, at least one.
    """
    if any(_features(scene, composer_of(spec), probes)):
        return ""
    every = spec.model_copy(update={"features": dict.fromkeys(Family, 1.0), "same_category": 0, "in_view": 0})
    possible = sorted(set(_features(scene, Composer(every.model_copy(update={"balanced": False})), probes)))
    rivals = max(scene.distractors(number) for number, _ in probes)
    what = ", ".join(possible) or f"none with fit = {spec.fit!r}"
    return (
        f"no instruction with these features fits a target; features possible in this scene: {what}; a target has at "
        f"most {rivals} other objects of its category"
    )


def _features(scene: SceneLanguage, composer: Composer, probes: Sequence[Probe]) -> Iterator[str]:
    """Yields the features of each instruction that is written for the probes."""
    for place, (number, view) in enumerate(probes):
        rng = np.random.default_rng((composer.spec.seed, place))
        for one in composer.write(scene, view, number, False, rng):
            yield one.features or "category alone"
