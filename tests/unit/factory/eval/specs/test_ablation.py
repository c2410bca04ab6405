"""Ablated instructions: never the original, deterministic, from existing categories."""

from __future__ import annotations

import dataclasses

import pytest

from factory.eval.models.result import Variant
from factory.eval.specs.campaign import instructions, playback_sources
from schemas.errors import UsageError
from tests.builders.eval_results import spec_of, specs_of
from tests.builders.scene import box_room

ROOM = dataclasses.replace(box_room()).info
SCENES = {"b" * 64: ROOM}
CATEGORIES = ("crate", "barrel", "crate", "barrel", "crate")
SET = specs_of(*(spec_of(n, category=category) for n, category in enumerate(CATEGORIES, 1)))


def test_a_shuffled_instruction_comes_from_another_episode() -> None:
    found = instructions(SET, Variant.SHUFFLED, SCENES)
    assert all(found[spec.spec_id] != spec.instruction for spec in SET.specs)
    assert set(found.values()) <= {spec.instruction for spec in SET.specs}
    assert found == instructions(SET, Variant.SHUFFLED, SCENES)


def test_a_wrong_instruction_names_another_category_in_the_same_template() -> None:
    found = instructions(SET, Variant.WRONG, SCENES)
    assert [found[spec.spec_id] for spec in SET.specs] == [
        f"Go to the {'barrel' if category == 'crate' else 'crate'}." for category in CATEGORIES
    ]


def test_a_wrong_instruction_prefers_a_visible_category() -> None:
    targets = ROOM.targets + tuple(
        ROOM.targets[0].model_copy(update={"target_id": f"{name}_1", "category": name}) for name in ("sofa", "table")
    )
    scenes = {"b" * 64: ROOM.model_copy(update={"targets": targets})}
    specs = specs_of(*(spec_of(n, category="crate", categories_in_view=("crate", "sofa")) for n in range(1, 20)))
    assert set(instructions(specs, Variant.WRONG, scenes).values()) == {"Go to the sofa."}


def test_a_wrong_instruction_with_a_colour_template_has_a_colour() -> None:
    spec = spec_of(1, category="crate", colour="red", template_id="train_06", instruction="Go to the red crate.")
    found = instructions(specs_of(spec), Variant.WRONG, SCENES)
    assert found["ep_000001"] == "Go to the red barrel."


def test_the_empty_variant_is_empty_and_the_original_variant_is_unchanged() -> None:
    assert set(instructions(SET, Variant.EMPTY, SCENES).values()) == {""}
    assert instructions(SET, Variant.ORIGINAL, SCENES)["ep_000001"] == "Go to the crate."


def test_an_impossible_ablation_is_reported() -> None:
    with pytest.raises(UsageError, match="the same instruction"):
        instructions(specs_of(spec_of(1), spec_of(2)), Variant.SHUFFLED, SCENES)
    alone = {"b" * 64: ROOM.model_copy(update={"targets": ROOM.targets[:1]})}
    with pytest.raises(UsageError, match="targets of category crate only"):
        instructions(specs_of(spec_of(1, category="crate")), Variant.WRONG, alone)


def test_the_playback_source_of_an_episode_is_another_archived_episode() -> None:
    found = playback_sources(SET)
    assert set(found) == {spec.spec_id for spec in SET.specs}
    assert all(found[spec.spec_id] != spec.source_episode for spec in SET.specs)
    with pytest.raises(UsageError, match="at least two"):
        playback_sources(specs_of(spec_of(1)))
