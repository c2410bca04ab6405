"""Which objects of a scene an instruction fits, and which objects an image shows."""

from __future__ import annotations

import numpy as np
import pytest

from schemas.episode_spec import EpisodeSpec
from schemas.instruction.referents import ids_in_view, named_colour, referents, referents_of
from schemas.instruction.templates import instruction
from schemas.scene import Instance, SceneInfo
from schemas.terms import Split, Tier
from tests.builders.catalog import make_entry, make_target


def _office() -> SceneInfo:
    targets = [
        make_target("chair", 1, 1, colour="red"),
        make_target("chair", 2, 2, colour="black"),
        make_target("chair", 3, 3, colour="black"),
        make_target("chair", 4, 4, colour="unknown"),
        make_target("plant", 1, 5, colour="green"),
    ]
    return make_entry("office", targets).info


def _spec(category: str, colour: str, template_id: str) -> EpisodeSpec:
    return EpisodeSpec(
        scene="office",
        tier=Tier.NEAR,
        split=Split.TRAIN_ID,
        category=category,
        target_id=f"{category}_001",
        colour=colour,
        template_id=template_id,
        instruction=instruction(template_id, category, colour),
    )


@pytest.mark.parametrize(
    ("category", "colour", "template_id", "fitting"),
    [
        ("chair", "red", "train_01", {1, 2, 3, 4}),
        ("chair", "red", "train_06", {1}),
        ("chair", "black", "train_06", {2, 3}),
        ("chair", "unknown", "train_01", {1, 2, 3, 4}),
        ("plant", "green", "train_01", {5}),
        ("plant", "green", "train_06", {5}),
        ("sofa", "red", "train_06", set()),
    ],
)
def test_an_instruction_fits_the_objects_of_its_category_and_of_the_colour_that_it_names(
    category, colour, template_id, fitting
):
    assert referents_of(_spec(category, colour, template_id), _office()) == fitting


def test_an_object_that_the_robot_cannot_reach_may_have_any_colour():
    info = _office()
    blocked = Instance(id=9, prim_path="/World/chair_9", category="chair")
    info = info.model_copy(update={"instances": (*info.instances, blocked)})
    assert referents(info, "chair", "red") == {1, 9}
    assert referents(info, "plant", "green") == {5}


def test_a_template_without_a_colour_slot_names_no_colour():
    assert named_colour("train_06", "red") == "red"
    assert named_colour("train_01", "red") is None
    assert named_colour("a_users_own", "red") is None


def test_an_image_shows_the_objects_with_enough_pixels_and_never_the_empty_id():
    ids = np.zeros((640, 640), np.uint16)
    ids[0, :40], ids[1, :31], ids[2, :32] = 7, 8, 65535
    assert ids_in_view(ids, 32) == {7, 65535}
    assert ids_in_view(np.zeros((640, 640), np.uint16), 1) == frozenset()
