"""The target list: reading, editing and applying it, and the messages for its errors."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from factory.scenes.compile.compiler import compile_stage
from factory.scenes.limits import StageLimits
from factory.scenes.targets.target_list import TargetList, format_target_list, load_target_list
from schemas.errors import UsageError, WorldError
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


@pytest.fixture(scope="module")
def scan(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A room as one mesh without names: floor, a table and a chair of the same faces."""
    lines, first = ["o scan"], 1
    things = [((-4, -3, -0.1), (4, 3, 0)), ((1, 1, 0), (2.2, 1.8, 0.75)), ((-2, -1, 0), (-1.5, -0.5, 0.9))]
    for (x0, y0, z0), (x1, y1, z1) in things:
        lines += [f"v {x} {y} {z}" for z in (z0, z1) for x, y in ((x0, y0), (x1, y0), (x1, y1), (x0, y1))]
        quads = ((0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7))
        lines += ["f " + " ".join(str(first + corner) for corner in quad) for quad in quads]
        first += 8
    path = tmp_path_factory.mktemp("scan") / "scan.obj"
    path.write_text("\n".join(lines))
    return path


BOX = "[[0.9, 0.9, 0.0], [2.3, 1.9, 0.8]]"
SEAT = "[[-2.1, -1.1, 0.0], [-1.4, -0.4, 1.0]]"


def boxed(folder: Path, *rows: str) -> TargetList:
    path = folder / "targets_scan.yaml"
    path.write_text("scene: scan\ntargets:\n" + "\n".join(f"- {{{row}}}" for row in rows))
    return load_target_list(path)


def compiled(scan: Path, chosen: TargetList | None) -> CompiledScene:
    return compile_stage(scan, "scan", "scan.obj", None, chosen, StageLimits(unit="m", up="z"))


def test_boxes_make_targets_of_a_scan_of_one_mesh(scan: Path, tmp_path: Path) -> None:
    with pytest.raises(WorldError, match=r"boxes of targets in a file with --targets \(.*; the scene extends"):
        compiled(scan, None)
    rows = (f"id: table_1, category: table, box_m: {BOX}", f"id: chair_1, category: chair, colour: red, box_m: {SEAT}")
    scene = compiled(scan, boxed(tmp_path, *rows))
    table, chair = scene.info.target("table_1"), scene.info.target("chair_1")
    assert table.centroid_m == pytest.approx((1.6, 1.4, 0.375))
    assert table.size_m == pytest.approx((1.2, 0.8, 0.75))
    assert (chair.colour, chair.prim_path) == ("red", "/Boxes/chair_1")
    assert [one.prim_path for one in scene.info.instances] == ["/Boxes/chair_1", "/Boxes/table_1", "/World/scan"]
    path = tmp_path / "again.yaml"
    path.write_text(format_target_list(scene.info))
    assert compiled(scan, load_target_list(path)).info.targets == scene.info.targets


def test_a_box_outside_the_scene_or_on_another_one_is_refused(scan: Path, tmp_path: Path) -> None:
    outside = boxed(tmp_path, "id: table_1, category: table, box_m: [[50, 1, 0], [51, 2, 1]]")
    with pytest.raises(UsageError, match=r"table_1: the box from \(50, 1, 0\).*extends from \(-4.00, -3.00, -0.10\)"):
        compiled(scan, outside)
    both = boxed(tmp_path, f"id: a_1, category: table, box_m: {BOX}", f"id: b_1, category: table, box_m: {BOX}")
    with pytest.raises(UsageError, match="boxes of a_1 and b_1 contain the same faces"):
        compiled(scan, both)


@pytest.mark.parametrize(
    ("row", "words"),
    [
        ("box_m: [[0, 0, 0], [1, 1, 0]]", "below the second one"),
        ("box_m: [[0, 0, 0], [1, .nan, 1]]", "box_m[1][1]"),
        ("box_m: [[0, 0, 0], [1, 1, 1e9]]", "box_m[1][2]"),
        ("box_m: [[0, 0], [1, 1]]", "box_m[0][2]"),
        ("box_m: [[0, 0, 0], [1, 1, 1]], prim_path: /World/A", "either `prim_path` or `box_m`"),
        ("colour: red", "give `prim_path`, or `box_m`"),
    ],
)
def test_a_box_that_is_not_valid_is_refused_with_its_row(tmp_path: Path, row: str, words: str) -> None:
    with pytest.raises(UsageError) as caught:
        boxed(tmp_path, f"id: a_1, category: table, {row}")
    assert "targets[0]" in str(caught.value)
    assert words in str(caught.value)
    with pytest.raises(UsageError, match="id is listed twice: a_1"):
        boxed(tmp_path, *[f"id: a_1, category: table, box_m: {BOX}"] * 2)
