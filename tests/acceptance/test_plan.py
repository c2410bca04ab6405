"""`factory plan` from the command line on infeasible plans."""

from __future__ import annotations

import pytest

from tests.builders.stage import StageText, room_body


def test_splits_that_get_no_episode_are_named(command):
    said = command("plan", "show", "demo", "--episodes", 4).stderr
    assert "4 episodes are too few; splits without episodes: test_id" in said
    assert "too few" not in command("plan", "show", "demo").stderr


IMPOSSIBLE = """
[tiers]
near = 1.0
[[scenes]]
name = "hospital"
episodes = 10
seen = ["chair", "sofa"]
held_out = ["barrel"]
"""


def test_an_infeasible_plan_is_refused_with_the_nearest_feasible_plan(command, tmp_path):
    plan, better = tmp_path / "plan.toml", tmp_path / "better.toml"
    plan.write_text(IMPOSSIBLE)
    err = command("run", plan, "--out", tmp_path / "x", expect=2).stderr
    assert "no reachable 'sofa' (seen), no reachable 'barrel' (held_out); reachable in the scene: chair" in err
    assert "cell test_ood_obj" not in err
    assert "nearest possible: hospital: seen without sofa; held_out without barrel" in err
    assert "factory plan nearest" in err
    assert not (tmp_path / "x").exists()
    found = command.json("plan", "nearest", plan, "-o", better)
    assert (found["possible"], found["moved"], len(found["mistakes"])) == (False, 1, 1)
    assert sum(row["episodes"] for row in found["cells"]) == 10
    again = command("plan", "nearest", better).stdout
    assert "feasible without changes: 10 episodes" in again


def test_a_plan_without_any_available_category_is_refused_with_the_available_ones(command, tmp_path):
    plan = tmp_path / "plan.toml"
    plan.write_text("[splits]\ntrain_id = 1.0\n" + IMPOSSIBLE.replace('"chair", ', ""))
    for verb in (("run", plan, "--out", tmp_path / "x"), ("plan", "nearest", plan)):
        err = command(*verb, expect=2).stderr
        assert "no reachable 'sofa' (seen), no reachable 'barrel' (held_out); reachable in the scene: chair" in err
        assert "to 0" not in err
        assert "can be reached" not in err


def test_showing_a_plan_with_a_missing_stage_names_the_expected_path(command, tmp_path):
    plan = tmp_path / "mine.toml"
    plan.write_text(
        '[splits]\ntrain_id = 1.0\n[[scenes]]\nname = "lab"\nusd = "lab/w.usda"\nseen = ["chair"]\nepisodes = 2\n'
    )
    assert f"no scene file at {tmp_path}/lab/w.usda" in command("plan", "show", plan, expect=2).stderr


def test_every_command_that_takes_a_stage_refuses_an_fbx_file_before_building(command, tmp_path):
    (tmp_path / "shop.fbx").write_bytes(b"Kaydara FBX Binary  \x00")
    plan = tmp_path / "mine.toml"
    plan.write_text(
        '[splits]\ntrain_id = 1.0\n[[scenes]]\nname = "office"\nepisodes = 1\n'
        '[[scenes]]\nname = "shop"\nfile = "shop.fbx"\nseen = ["chair"]\nepisodes = 2\n'
    )
    for verb in (
        ("scene", "import", tmp_path / "shop.fbx", "-o", tmp_path / "cache"),
        ("scene", "inspect", tmp_path / "shop.fbx"),
        ("scene", "survey", tmp_path / "shop.fbx"),
        ("plan", "show", plan),
        ("plan", "nearest", plan),
        ("run", plan, "--out", tmp_path / "x"),
        ("gate", plan, "--scene", "shop"),
        ("coordinator", "start", plan, "--out", tmp_path / "x"),
    ):
        err = command(*verb, expect=2).stderr
        assert "shop.fbx is FBX, which is not read; supported are .usd, .usda, .usdc, .usdz, .gltf, .glb" in err, verb
        assert "bpy.ops.import_scene.fbx(filepath='shop.fbx')" in err
        assert "building" not in err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["mine.toml", "shop.fbx"]


def test_a_custom_scene_is_compiled_once_and_then_checked_against_the_plan(command, tmp_path):
    StageText().write(tmp_path / "room.usda", room_body(StageText()))
    plan = tmp_path / "mine.toml"
    plan.write_text(
        '[splits]\ntrain_id = 1.0\n[[scenes]]\nname = "loft"\nusd = "room.usda"\nseen = ["chair", "bed"]\n'
        "episodes = 2\n"
    )
    before = command("plan", "show", plan)
    assert "was not checked against its scenes, because these are not built: loft" in before.stderr
    assert "factory plan nearest" in before.stderr
    assert "building loft" in command("plan", "nearest", plan).stderr
    assert "building" not in command("plan", "nearest", plan).stderr
    after = command("plan", "show", plan)
    assert "impossible: scenes[0] loft: no reachable 'bed' (seen); reachable in the scene: chair;" in after.stdout
    assert after.stderr == ""
    told = command.json("plan", "show", plan)
    assert (len(told["mistakes"]), told["not_built"]) == (1, [])


def test_a_plan_is_shown_with_its_categories_templates_and_expected_ambiguity(command, tmp_path):
    text = StageText()
    bin_body = text.box("Body", (-2.2, -1.2, 0.0), (-1.8, -0.8, 0.5), (0.01, 0.01, 0.6))
    second = text.group("SM_TrashCan_02", bin_body.replace("Body", "Second"), at=(0.0, 2.0, 0.0))
    bins = text.group("SM_TrashCan_01", bin_body) + second
    text.write(tmp_path / "room.usda", room_body(text, bins))
    plan = tmp_path / "mine.toml"
    plan.write_text(
        'balance = "categories_overall"\n[instructions]\nunique = "view"\n[tiers]\nnear = 1.0\n[splits]\n'
        'train_id = 1.0\n[[scenes]]\nname = "den"\nusd = "room.usda"\nseen = ["chair", "trash_can"]\nepisodes = 40\n'
    )
    command("plan", "nearest", plan)
    shown = command("plan", "show", plan).stdout
    assert "share of the three most frequent categories: 100.0%" in shown
    assert "expected ambiguity: 50.0% of the instructions fit several objects of the scene" in shown
    assert "(50.0% with a start that shows only the target, 0.0% without)" in shown
    content = command.json("plan", "show", plan)["content"]
    assert content["far_corner_shares"] == {}
    assert {row["category"]: (row["episodes"], row["share"]) for row in content["categories"]} == {
        "chair": (20, 0.5),
        "trash_can": (20, 0.5),
    }
    assert sum(row["episodes"] for row in content["templates"]) == 40
    assert (content["ambiguous_share"], content["shown_alone_share"]) == (0.5, 0.5)
    plan.write_text(plan.read_text().replace('"view"', '"scene"'))
    refused = command("run", plan, "--out", tmp_path / "x", expect=2).stderr
    assert "no instruction fits only one trash_can; unique in the scene: chair, red chair;" in refused


def test_a_plan_with_layouts_shows_patterns_and_asked_features_before_they_are_built(command, tmp_path):
    plan = tmp_path / "homes.toml"
    plan.write_text(
        "[language.features]\nnear = 3\n[language.largest_shares]\nordinal = 0.25\n[splits]\ntrain_id = 1.0\n[tiers]\n"
        'near = 1.0\n[[scenes]]\nname = "home"\nlayouts = 2\nepisodes = 4\nseed = 7123\n'
    )
    shown = command("plan", "show", plan).stdout
    assert "sentence patterns" in shown
    assert "layouts of home that are built and counted: 0 of 2" in shown
    assert "the expected shares are known when its layouts are built; a run builds them" in shown
    rows = {row["feature"]: row for row in command.json("plan", "show", plan)["features"]}
    assert rows["near"]["asked"] == pytest.approx(3 / 17)
    assert (rows["ordinal"]["asked"], rows["ordinal"]["largest"]) == (pytest.approx(1 / 17), 0.25)
    assert rows["near"]["expected"] is None
