"""The target list: reading, editing and applying it, and the messages for its errors."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from factory.scenes.compile.compiler import compile_stage
from factory.scenes.targets.target_list import TargetList, format_target_list, load_target_list
from schemas.errors import UsageError
from schemas.scene import CompiledScene
from tests.builders.stage import StageText, room_body

TEXT = StageText()
PLANT = TEXT.group("SM_Plant_01", TEXT.box("Pot", (-2.2, -1.2, 0), (-1.8, -0.8, 0.6), (0.02, 0.4, 0.02)))
LAMP = TEXT.group("Lantern", TEXT.box("Post", (-2.1, 1.4, 0), (-1.9, 1.6, 0.9), (0.01, 0.01, 0.6)))


@pytest.fixture(scope="module")
def stage(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return TEXT.write(tmp_path_factory.mktemp("stage") / "room.usda", room_body(TEXT, PLANT + LAMP))


@pytest.fixture(scope="module")
def plain(stage: Path) -> CompiledScene:
    return compile_stage(stage, "room", "room.usda")


def edited(stage: Path, plain: CompiledScene, **changes: dict[str, object]) -> CompiledScene:
    """Compiles the room again with changed rows of some targets; new ids add rows."""
    data = yaml.safe_load(format_target_list(plain.info))
    rows = {row["id"]: row for row in data["targets"]}
    for name, change in changes.items():
        rows[name] = {**rows.get(name, {"id": name}), **change}
    chosen = TargetList.model_validate({**data, "targets": tuple(rows.values())})
    return compile_stage(stage, "room", "room.usda", None, chosen)


def test_the_list_as_written_gives_the_same_targets(stage: Path, plain: CompiledScene) -> None:
    again = edited(stage, plain)
    assert again.info.targets == plain.info.targets
    assert (again.part_instance == plain.part_instance).all()


def test_a_disabled_target_stays_in_the_scene_as_an_object(stage: Path, plain: CompiledScene) -> None:
    scene = edited(stage, plain, plant_001={"enabled": False})
    assert [target.target_id for target in scene.info.targets] == ["chair_001"]
    assert "plant" in {instance.category for instance in scene.info.instances}


def test_category_colour_and_id_are_taken_from_the_list(stage: Path, plain: CompiledScene) -> None:
    change = {"id": "stool_9", "category": "stool", "colour": "pink"}
    target = edited(stage, plain, chair_001=change).info.target("stool_9")
    assert (target.category, target.colour, target.prim_path) == ("stool", "pink", "/World/SM_Chair_01")
    assert target.centroid_m == plain.info.target("chair_001").centroid_m


def test_a_prim_that_no_rule_knows_can_be_added(stage: Path, plain: CompiledScene) -> None:
    row = {"category": "lantern", "colour": "blue", "prim_path": "/World/Lantern"}
    target = edited(stage, plain, lantern_001=row).info.target("lantern_001")
    assert target.centroid_m == pytest.approx((-2.0, 1.5, 0.45))


def test_the_source_digest_covers_the_applied_edits(stage: Path, plain: CompiledScene) -> None:
    digests = [
        scene.info.source_sha256
        for scene in (
            plain,
            edited(stage, plain),
            edited(stage, plain, chair_001={"colour": "blue"}),
            edited(stage, plain, chair_001={"size_m": (9.0, 9.0, 9.0)}),
        )
    ]
    assert len(set(digests)) == 3
    assert digests[1] == digests[3]


def test_unknown_prims_are_all_named(stage: Path, plain: CompiledScene) -> None:
    rows = {name: {"category": "cat", "prim_path": f"/World/{name}"} for name in ("tom", "kit")}
    with pytest.raises(UsageError, match=r"/World/tom, /World/kit.*factory scene targets"):
        edited(stage, plain, **rows)


def test_a_prim_inside_another_is_refused(stage: Path, plain: CompiledScene) -> None:
    row = {"category": "seat", "prim_path": "/World/SM_Chair_01/Seat"}
    with pytest.raises(UsageError, match="SM_Chair_01/Seat is inside prim /World/SM_Chair_01"):
        edited(stage, plain, seat_001=row)


ROW = "{id: a_1, category: chair, prim_path: /World/A}"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("targets: [", ["YAML"]),
        (
            "scene: room\ntargets:\n- id: a_1\n  category: chair\n  prim_path: /A\n  category: chair\n  prim_path: /B",
            ["category, prim_path", "line 3", "check for a missing line"],
        ),
        ("scene: room\ntargets: 7", ["targets"]),
        (f"scene: room\ntargets: [{ROW}, {ROW}]", ["id is listed twice: a_1"]),
        (
            "scene: room\ntargets: [{id: a_1, category: chair, prim_path: /A, enabled: false}]",
            ["all targets are disabled"],
        ),
        (
            "scene: room\ntargets: [{id: a_1, category: chair, prim_path: /A, colour: teal}]",
            ["targets[0].colour", "red"],
        ),
        ("scene: room\ntargets: [{id: A 1, category: chair, prim_path: /A, kolour: red}]", ["targets[0].id", "kolour"]),
    ],
)
def test_mistakes_are_named_by_row_and_key(tmp_path: Path, text: str, words: list[str]) -> None:
    path = tmp_path / "targets_room.yaml"
    path.write_text(text)
    with pytest.raises(UsageError) as caught:
        load_target_list(path)
    assert all(word in str(caught.value) for word in (*words, "targets_room.yaml")), str(caught.value)


def test_a_missing_file_is_refused_with_the_complete_command_that_writes_one(tmp_path: Path) -> None:
    path = tmp_path / "my targets.yaml"
    with pytest.raises(UsageError) as caught:
        load_target_list(path, "lab")
    assert f"`factory scene targets lab -o '{path}'`" in str(caught.value)
    assert "Errno" not in str(caught.value)


def test_a_written_list_is_read_back(tmp_path: Path, plain: CompiledScene) -> None:
    path = tmp_path / "targets_room.yaml"
    path.write_text(format_target_list(plain.info))
    rows = load_target_list(path).targets
    assert [row.id for row in rows] == [target.target_id for target in plain.info.targets]
    assert all(row.enabled for row in rows)
