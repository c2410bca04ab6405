"""Instruction variants for the language ablation: shuffled, wrong category, empty. Pure functions.

A policy that succeeds equally often with wrong instructions does not use them (paper Sec. VII, language-ablation
baseline).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from factory.eval.models.result import Variant
from factory.eval.models.spec import EvalSpec, SpecSet
from schemas.errors import UsageError
from schemas.instruction.language import TEMPLATES, instruction, needs_colour
from schemas.scene import SceneInfo

ABLATIONS = (Variant.SHUFFLED, Variant.WRONG, Variant.EMPTY)
_WRONG_STREAM, _SHUFFLE_STREAM, _DONOR_STREAM = 11, 12, 13

Scenes = Mapping[str, SceneInfo]
"""SHA-256 of a scene package -> its contents."""


def instructions(specs: SpecSet, variant: Variant, scenes: Scenes) -> dict[str, str]:
    """Returns the instruction of each spec under a variant, by spec id; deterministic for a spec set.

    Args:
        specs: Spec set.
        variant: Instruction variant.
        scenes: Scenes of the set, for their categories.

    Raises:
        UsageError: All instructions of the set are equal, or a scene has only one category.
    """
    if variant is Variant.SHUFFLED:
        return _shuffled(specs)
    if variant is Variant.WRONG:
        return {spec.spec_id: _wrong(spec, scenes[spec.scene_sha256]) for spec in specs.specs}
    if variant is Variant.EMPTY:
        return {spec.spec_id: "" for spec in specs.specs}
    return {spec.spec_id: spec.instruction for spec in specs.specs}


def playback_sources(specs: SpecSet) -> dict[str, str]:
    """Returns for each spec id the id of another archived episode, whose actions the policy `playback` executes.

    Raises:
        UsageError: Fewer than two archived episodes are in the set.
    """
    recorded = [spec for spec in specs.specs if spec.source_episode is not None]
    if len({spec.source_episode for spec in recorded}) < 2:
        raise UsageError(
            "policy playback needs specs of at least two archived episodes; increase --episodes, or add a --split"
        )
    rng = np.random.default_rng(np.random.SeedSequence((int(specs.digest[:8], 16), _DONOR_STREAM)))
    ring = [recorded[int(number)] for number in rng.permutation(len(recorded))]
    found: dict[str, str] = {}
    for place, spec in enumerate(ring):
        others = (ring[(place + step) % len(ring)].source_episode for step in range(1, len(ring)))
        found[spec.spec_id] = next(name for name in others if name is not None and name != spec.source_episode)
    return found


def _shuffled(specs: SpecSet) -> dict[str, str]:
    if len({spec.instruction for spec in specs.specs}) < 2:
        raise UsageError(
            "all episodes have the same instruction, so it cannot be shuffled; increase --episodes, or add a --split"
        )
    rng = np.random.default_rng(np.random.SeedSequence((int(specs.digest[:8], 16), _SHUFFLE_STREAM)))
    ring = [specs.specs[int(number)] for number in rng.permutation(len(specs.specs))]
    found: dict[str, str] = {}
    for place, spec in enumerate(ring):
        others = (ring[(place + step) % len(ring)].instruction for step in range(1, len(ring)))
        found[spec.spec_id] = next(words for words in others if words != spec.instruction)
    return found


def _wrong(spec: EvalSpec, scene: SceneInfo) -> str:
    """Returns the template with another category, preferably one in view at the start."""
    there = sorted({target.category for target in scene.targets} - {spec.category})
    if not there:
        raise UsageError(
            f"scene {spec.scene} has targets of category {spec.category} only, so there is no wrong category"
        )
    rng = np.random.default_rng(np.random.SeedSequence((spec.seed, _WRONG_STREAM)))
    in_view = [category for category in there if category in spec.categories_in_view]
    category = str(rng.choice(in_view or there))
    if spec.template_id not in TEMPLATES:
        raise UsageError(
            f"{spec.spec_id}: {spec.template_id!r} is not a template, so its category cannot be changed; omit the "
            "variant `wrong` (`shuffled` gives other instructions)"
        )
    return instruction(spec.template_id, category, _colour(spec, scene, category, rng))


def _colour(spec: EvalSpec, scene: SceneInfo, category: str, rng: np.random.Generator) -> str:
    if not needs_colour(spec.template_id):
        return spec.colour
    known = [target.colour for target in scene.targets if target.category == category and target.colour != "unknown"]
    return str(rng.choice(sorted(known))) if known else spec.colour
