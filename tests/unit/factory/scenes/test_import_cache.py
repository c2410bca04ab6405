"""An unchanged stage is compiled once; every change of an input triggers compilation."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from factory.runs.scene_packages import find_imported
from factory.scenes.build import find_import, import_scene, name_of_file
from factory.scenes.limits import USUAL_LIMITS, StageLimits
from factory.scenes.rules import RuleBook, builtin_rules
from factory.scenes.targets.target_list import TargetEntry, TargetList
from schemas.errors import UsageError
from tests.builders.stage import StageText, room_body

TEXT = StageText()
BOXES = {"a.usda": 0.5, "b.usda": 1.0}


@pytest.fixture
def stage(tmp_path: Path) -> Path:
    """A room with two boxes of different height from separate files."""
    for name, height in BOXES.items():
        TEXT.write(tmp_path / name, TEXT.box("Box", (0, 0, 0), (0.5, 0.5, height)))
    boxes = "".join(
        TEXT.group(name[0].upper(), "", at=(-2.0, place, 0.0), head=f"references = @./{name}@")
        for place, name in enumerate(BOXES)
    )
    return TEXT.write(tmp_path / "room.usda", room_body(TEXT, boxes))


def imported(
    stage: Path,
    rules: RuleBook | None = None,
    targets: TargetList | None = None,
    limits: StageLimits = USUAL_LIMITS,
) -> tuple[Path, bool]:
    """Returns the package, and whether it was compiled in this call."""
    told: list[str] = []
    cache = stage.parent / "cache"
    return import_scene(stage, "lab", cache, rules, targets, limits, lambda: told.append("lab")), bool(told)


def test_a_stage_is_compiled_once(stage: Path) -> None:
    first, second = imported(stage), imported(stage)
    assert first[0] == second[0]
    assert (first[1], second[1]) == (True, False)


def test_a_changed_layer_rule_or_target_list_triggers_compilation(stage: Path) -> None:
    imported(stage)
    chair = TargetEntry(id="chair_001", category="chair", prim_path="/World/SM_Chair_01")
    assert imported(stage, targets=TargetList(scene="lab", targets=(chair,)))[1]
    assert imported(stage, rules=RuleBook(rules=builtin_rules().rules[:6]))[1]
    TEXT.write(stage.parent / "a.usda", TEXT.box("Box", (0, 0, 0), (0.5, 0.5, 0.7)))
    assert imported(stage)[1]


def test_only_a_changed_ceiling_triggers_compilation(stage: Path) -> None:
    imported(stage)
    low, high = (imported(stage, limits=StageLimits(ceiling_m=height)) for height in (2.6, 3.0))
    assert (low[1], high[1]) == (True, True)
    assert low[0] != high[0]
    assert imported(stage, limits=StageLimits(ceiling_m=2.6)) == (low[0], False)


def test_swapped_files_trigger_compilation(stage: Path) -> None:
    old, _ = imported(stage)
    first, second = (stage.parent / name for name in BOXES)
    one, other = first.read_bytes(), second.read_bytes()
    first.write_bytes(other)
    second.write_bytes(one)
    new, compiled = imported(stage)
    assert compiled
    assert new != old


def test_a_file_that_appears_triggers_compilation(stage: Path) -> None:
    layer = stage.parent / "a.usda"
    text = layer.read_bytes()
    layer.unlink()
    imported(stage)
    layer.write_bytes(text)
    assert imported(stage)[1]


@pytest.mark.parametrize("damage", [b"not what its name says", None])
def test_a_damaged_or_missing_package_is_compiled_again(stage: Path, damage: bytes | None) -> None:
    package, _ = imported(stage)
    good = package.read_bytes()
    package.unlink()
    if damage is not None:
        package.write_bytes(damage)
    assert imported(stage) == (package, True)
    assert package.read_bytes() == good


def test_importing_again_makes_a_package_the_newest(stage: Path) -> None:
    first, _ = imported(stage)
    second, _ = imported(stage, rules=RuleBook(rules=builtin_rules().rules[:6]))
    for package in (first, second):
        os.utime(package, (1, 1))
    imported(stage)
    assert find_imported(first.parent) == {"lab": (first, second)}


def test_searching_for_a_package_compiles_nothing(stage: Path) -> None:
    cache = stage.parent / "cache"
    assert find_import(stage, "lab", cache) is None
    package, _ = imported(stage)
    os.utime(package, (1, 1))
    assert find_import(stage, "lab", cache) == package
    assert package.stat().st_mtime == 1


@pytest.mark.parametrize(
    ("file", "name"),
    [
        ("my-room.obj", "my_room"),
        ("My Room (2).glb", "my_room_2"),
        ("2nd floor.usd", "scene_2nd_floor"),
        ("B\u00fcro.dae", "buro"),
        ("\u623f\u95f4.obj", "scene"),
        ("office.glb", "my_office"),
        ("home_00007.glb", "my_home_00007"),
        (f"{'a' * 300}.obj", "a" * 64),
    ],
)
def test_a_file_name_gives_a_valid_scene_name(stage: Path, file: str, name: str) -> None:
    assert name_of_file(Path(file)) == name
    if name in ("my_room", "my_home_00007"):
        assert find_imported(import_scene(stage, name, stage.parent / "named").parent) == {
            name: tuple((stage.parent / "named").glob("*.scene.zip"))
        }


@pytest.mark.parametrize(
    ("name", "remedy"),
    [("My-Room", "--name my_room"), ("office", "--name room"), ("office_00007", "--name room"), ("../x", "--name x")],
)
def test_a_name_that_is_refused_is_answered_with_one_that_works(stage: Path, name: str, remedy: str) -> None:
    with pytest.raises(UsageError) as caught:
        import_scene(stage, name, stage.parent / "cache")
    assert str(caught.value).endswith(remedy)
    assert import_scene(stage, remedy.split()[1], stage.parent / "cache").is_file()
