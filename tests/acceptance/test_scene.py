"""`factory scene` from the command line: inspection, survey, and edited target lists."""

from __future__ import annotations

import pytest

from tests.builders.stage import StageText, room_body

TEXT = StageText()


def room(command, folder, body=None):
    folder.mkdir(exist_ok=True)
    stage = TEXT.write(folder / "room.usda", room_body(TEXT) if body is None else body)
    return stage, command.json("scene", "import", stage, "-o", folder / "cache")["package"]


@pytest.fixture(scope="module")
def compiled(command, tmp_path_factory):
    """USD file of a room and its compiled package; tests only read them."""
    return room(command, tmp_path_factory.mktemp("room"))


def test_inspect_prints_targets_units_and_extents_and_draws_a_map(command, compiled, tmp_path):
    _, package = compiled
    out = command("scene", "inspect", package, "-o", tmp_path / "map.png").stdout
    assert "metres_per_unit: 1.0" in out
    assert "extents_m: 8.4 x 6.4 x 2.6" in out
    assert "chair_001" in out
    assert (tmp_path / "map.png").read_bytes().startswith(b"\x89PNG")
    facts = command.json("scene", "inspect", package)
    assert facts["targets"][0]["colour"] == "red"


def test_inspect_refuses_a_stage_and_names_the_compile_command(command, compiled):
    stage, _ = compiled
    assert "factory scene import" in command("scene", "inspect", stage, expect=2).stderr


def test_an_imported_scene_is_found_by_name(command, tmp_path):
    plant = TEXT.box("SM_Plant_01", (-2.2, -1.2, 0), (-1.8, -0.8, 0.6))
    stage = TEXT.write(tmp_path / "room.usda", room_body(TEXT, plant))
    made = command("scene", "import", stage, "--name", "cellar")
    assert (
        "targets: 1 chair, 1 plant\nnot targets: 5 of 7 instances\n  5 without a category: /World/Floor" in made.stdout
    )
    assert "--rules FILE" in made.stdout
    assert "next:    factory scene inspect cellar" in made.stdout
    plan = tmp_path / "cellar.toml"
    plan.write_text(made.stdout[made.stdout.index('name = "cellar"') :])
    assert command.json("plan", "nearest", plan)["possible"]
    assert "not targets: 5 of 7 instances" in command("scene", "inspect", "cellar").stdout
    assert command.json("scene", "survey", "cellar")["spawns"] >= 40
    assert command.json("scene", "targets", "cellar", "-o", tmp_path / "list.yaml")["scene"] == "cellar"
    assert "did you mean 'cellar'?" in command("scene", "inspect", "cellarr", expect=2).stderr
    (listed,) = [scene for scene in command.json("scene", "list") if scene["name"] == "cellar"]
    assert (listed["origin"], listed["summary"], listed["targets"]) == ("imported", "room.usda", "1 chair, 1 plant")
    assert listed["package"] in command("scene", "list").stdout

    TEXT.write(stage, room_body(TEXT))
    last = command.json("scene", "import", stage, "--name", "cellar")["package"]
    again = command("scene", "inspect", "cellar")
    assert "categories: 1 chair\n" in again.stdout
    assert f"cellar was imported 2 times; the last import is used: {last}" in again.stderr


def test_a_ceiling_added_at_import_is_part_of_the_printed_plan(command, tmp_path):
    stage = TEXT.write(tmp_path / "room.usda", room_body(TEXT))
    made = command("scene", "import", stage, "--name", "loft", "--ceiling", "2.8")
    plan = tmp_path / "loft.toml"
    plan.write_text(made.stdout[made.stdout.index('name = "loft"') :])
    assert "ceiling_m = 2.8" in plan.read_text()
    assert command.json("plan", "nearest", plan)["possible"]
    facts = command.json("scene", "inspect", "loft")
    assert "/AddedCeiling" in [thing["prim_path"] for thing in facts["no_target"]]
    assert "1.0<=x<=100.0" in command("scene", "import", stage, "--ceiling", "0.5", expect=2).stderr


def test_a_package_in_another_folder_is_found_by_path(command, tmp_path):
    stage = TEXT.write(tmp_path / "room.usda", room_body(TEXT))
    made = command.json("scene", "import", stage, "--name", "attic", "-o", tmp_path / "a b")
    assert made["next"][0] == f"factory scene inspect '{made['package']}' -o attic.png"
    assert [thing["category"] for thing in made["no_target"]] == [None] * 5
    assert "'attic' is neither a scene nor an existing file" in command("scene", "inspect", "attic", expect=2).stderr


def test_survey_passes_a_good_scene_and_fails_a_small_one_with_the_reason(command, compiled, tmp_path):
    _, package = compiled
    report = command.json("scene", "survey", package)
    assert report["spawns"] >= 40
    assert report["share_within"] == 1.0
    words = command("scene", "survey", package).stdout
    assert "start points without a visible target: " in words
    assert "floor within 2 m of a start point: 100.0 %" in words
    assert not any(key in words for key in ("blind", "share_within", "farthest_floor_m"))
    closet = TEXT.box("Floor", (0, 0, -0.1), (2, 2, 0)) + TEXT.box("SM_Crate_01", (0.2, 0.2, 0), (0.5, 0.5, 0.4))
    _, small = room(command, tmp_path / "small", closet)
    assert "of 40 recommended spawn points" in command("scene", "survey", small, expect=1).stderr


def test_import_and_plans_apply_an_edited_target_list(factory, command, tmp_path):
    plant = TEXT.box("SM_Plant_01", (-2.2, -1.2, 0), (-1.8, -0.8, 0.6), (0.02, 0.4, 0.02))
    stage, package = room(command, tmp_path, room_body(TEXT, plant))
    edits = tmp_path / "targets_room.yaml"
    assert command.json("scene", "targets", package, "-o", edits)["targets"] == 2
    assert "--force" in command("scene", "targets", package, "-o", edits, expect=2).stderr
    edits.write_text(edits.read_text().replace("colour: red", "colour: blue").replace("id: plant_001", "id: ficus_7"))
    facts = command.json("scene", "import", stage, "--targets", edits, "-o", tmp_path / "cache")
    found = command.json("scene", "inspect", facts["package"])["targets"]
    assert [(target["id"], target["colour"]) for target in found] == [("chair_001", "blue"), ("ficus_7", "green")]
    plan = tmp_path / "mine.toml"
    plan.write_text(
        '[splits]\ntrain_id = 1.0\n[tiers]\nnear = 1.0\n[[scenes]]\nname = "my_room"\nusd = "room.usda"\n'
        'targets = "targets_room.yaml"\nseen = ["plant"]\nepisodes = 1\n'
    )
    factory("run", plan, "--out", tmp_path / "data", "--record", "states", "--workers", 1)
    written = (tmp_path / "data" / "scenes" / "targets_my_room.yaml").read_text()
    assert "id: ficus_7" in written
    assert "colour: blue" in written
    assert command.json("verify", tmp_path / "data", "--deep")["findings"] == []


def test_a_target_list_with_an_unknown_prim_is_refused_with_the_prim_path(command, compiled, tmp_path):
    stage, package = compiled
    edits = tmp_path / "targets_room.yaml"
    command("scene", "targets", package, "-o", edits)
    edits.write_text(edits.read_text().replace("SM_Chair_01", "SM_Throne_01"))
    assert "/World/SM_Throne_01" in command("scene", "import", stage, "--targets", edits, expect=2).stderr


def test_render_writes_map_views_and_sheets_and_names_them(command, compiled, tmp_path):
    _, package = compiled
    out = tmp_path / "pictures"
    result = command.json(
        "scene", "render", package, "-o", out, "--views", 1, "--robot-views", 1, "--colours", 1, "--renderer", "gl"
    )
    names = ["map.png", "eye_00.png", "robot_00.png", "categories.png", "colours.png"]
    assert result == {"scene": "room", "pictures": [str(out / name) for name in names]}
    for name in names:
        assert (out / name).read_bytes().startswith(b"\x89PNG")


def test_render_refuses_an_output_that_is_not_a_folder(command, compiled, tmp_path):
    _, package = compiled
    (tmp_path / "taken").write_text("a file")
    assert "choose another --out" in command("scene", "render", package, "-o", tmp_path / "taken", expect=1).stderr


BAD = {
    "no mesh": (TEXT.group("Empty", ""), "1", "at or below /World"),
    "no floor": (TEXT.box("Wall", (0, 0, 0), (5, 0.1, 3)), "1", "widest prim /World/Wall"),
    "no unit": (room_body(TEXT), "0", "has metersPerUnit = 0"),
    "a floor of kilometres": (room_body(TEXT), "1000", "widest prim /World/Floor"),
    "no known thing": (TEXT.box("Floor", (0, 0, -0.1), (8, 8, 0)), "1", "such as /World/Floor"),
    "a circle": (TEXT.group("Loop", "", head="references = </World>"), "1", "In </World/Loop>: Cycle detected"),
}


@pytest.mark.parametrize("what", BAD)
def test_an_unusable_stage_is_refused_with_the_reason_and_leaves_only_its_map(command, tmp_path, what):
    body, unit, words = BAD[what]
    stage = TEXT.write(tmp_path / "bad.usda", body, units=f"metersPerUnit = {unit}")
    error = command("scene", "import", stage, "-o", tmp_path / "cache", expect=1).stderr
    assert words in error
    assert "Traceback" not in error
    left = [path for path in tmp_path.rglob("*") if path.is_file()]
    assert [path for path in left if path.name != "bad.map.png"] == [stage]
