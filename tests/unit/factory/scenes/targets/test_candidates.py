"""The outermost match is the object; containers, groups and scopes are descended."""

from __future__ import annotations

from pathlib import Path

import pytest

from factory.scenes.importer import extract_stage
from factory.scenes.rules import load_rules
from factory.scenes.targets.candidates import find_candidates
from tests.builders.stage import StageText, Vector3

TEXT = StageText()


def box(name: str, at: float = 0.0, size: float = 0.8, colour: Vector3 = (0.5, 0.5, 0.5)) -> str:
    return TEXT.box(name, (at, 0, 0), (at + size, size, size), colour)


def found(tmp_path: Path, body: str) -> list[tuple[str, str]]:
    extraction = extract_stage(TEXT.write(tmp_path / "scene.usda", body))
    candidates = find_candidates(extraction, extraction.parts, load_rules())
    return [(candidate.path.removeprefix("/World/"), candidate.category) for candidate in candidates]


def test_the_outermost_match_is_the_target(tmp_path: Path) -> None:
    rack = TEXT.group("SM_RackPile_04", box("Frame") + box("SM_CratePlastic_01", 0.2, 0.5))
    assert found(tmp_path, rack) == [("SM_RackPile_04", "rack")]


def test_a_container_of_adjacent_objects_is_descended(tmp_path: Path) -> None:
    chairs = TEXT.group("Chairs", box("Chair_1", 0) + box("Chair_2", 1.0))
    assert found(tmp_path, chairs) == [("Chairs/Chair_1", "chair"), ("Chairs/Chair_2", "chair")]


def test_stacked_boards_are_one_shelf(tmp_path: Path) -> None:
    boards = "".join(TEXT.box(f"Shelf_{z}", (0, 0, z * 0.5), (1, 0.4, z * 0.5 + 0.05)) for z in range(4))
    assert found(tmp_path, TEXT.group("Bookcase", boards)) == [("Bookcase", "shelf")]


@pytest.mark.parametrize("head", ['kind = "group"', 'kind = "assembly"'])
def test_groups_are_descended_by_kind(tmp_path: Path, head: str) -> None:
    assert found(tmp_path, TEXT.group("Table_Area", box("Desk_1"), head=head)) == [("Table_Area/Desk_1", "table")]


def test_scopes_are_descended(tmp_path: Path) -> None:
    assert found(tmp_path, TEXT.group("Tables", box("Desk_1"), kind="Scope")) == [("Tables/Desk_1", "table")]


def test_prims_below_a_component_are_not_separate_objects(tmp_path: Path) -> None:
    stand = TEXT.group("SM_Nightstand", box("Table_top"), head='kind = "component"')
    assert found(tmp_path, stand) == []


def test_prims_of_implausible_size_are_no_objects_but_may_contain_objects(tmp_path: Path) -> None:
    hall = TEXT.group("TableHall", box("Floor", 0, 30.0) + box("Desk_1"))
    assert found(tmp_path, hall + box("Chair_toy", 0, 0.05)) == [("TableHall/Desk_1", "table")]


def test_authored_labels_have_priority_over_names(tmp_path: Path) -> None:
    label = 'string semantic:Semantics:params:semanticData = "chair"\n'
    assert found(tmp_path, TEXT.group("Thing_17", label + box("Part"))) == [("Thing_17", "chair")]


def test_copies_of_a_point_instancer_are_objects(tmp_path: Path) -> None:
    instancer = f"""
    def PointInstancer "Crates" {{
        rel prototypes = </World/Crates/Crate>
        int[] protoIndices = [0, 0]
        point3f[] positions = [(0, 0, 0), (5, 0, 0)]
        {TEXT.group("Crate", box("Body"))}
    }}"""
    assert found(tmp_path, instancer) == [("Crates/Crate[0]", "crate"), ("Crates/Crate[1]", "crate")]
