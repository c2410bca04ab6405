"""`factory scene` as a user runs it: looking into scenes, measuring them, editing what can be named in them."""

from __future__ import annotations

from tests.builders.stage import StageText, room_body

TEXT = StageText()


def room(factory, folder, body=None):
    folder.mkdir(exist_ok=True)
    stage = TEXT.write(folder / "room.usda", room_body(TEXT) if body is None else body)
    return stage, factory.json("scene", "import", stage, "--cache", folder / "cache")["package"]


def test_inspect_prints_targets_units_and_extents_and_draws_a_map(factory, tmp_path):
    _, package = room(factory, tmp_path)
    out = factory("scene", "inspect", package, "-o", tmp_path / "map.png").stdout
    assert "metres_per_unit: 1.0" in out
    assert "extents_m: 8.4 x 6.4 x 2.6" in out
    assert "chair_001" in out
    assert (tmp_path / "map.png").read_bytes().startswith(b"\x89PNG")
    facts = factory.json("scene", "inspect", package)
    assert facts["targets"][0]["colour"] == "red"


def test_inspect_refuses_a_stage_with_the_verb_that_compiles_it(factory, tmp_path):
    stage, _ = room(factory, tmp_path)
    assert "factory scene import" in factory("scene", "inspect", stage, expect=2).stderr


def test_survey_passes_a_good_scene_and_fails_a_small_one_with_the_reason(factory, tmp_path):
    _, package = room(factory, tmp_path)
    report = factory.json("scene", "survey", package)
    assert report["spawns"] >= 40
    assert report["share_within"] == 1.0
    assert "targets in sight" in factory("scene", "survey", package).stdout
    closet = TEXT.box("Floor", (0, 0, -0.1), (2, 2, 0)) + TEXT.box("SM_Crate_01", (0.2, 0.2, 0), (0.5, 0.5, 0.4))
    _, small = room(factory, tmp_path / "small", closet)
    assert "spawn points of 40" in factory("scene", "survey", small, expect=1).stderr
