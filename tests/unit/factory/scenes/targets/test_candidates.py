"""The outermost matching prim is the object; containers, groups and scopes are searched. Shape and colour must fit."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from factory.scenes.compile.surfaces import target_colour
from factory.scenes.compile.textures import load_textures
from factory.scenes.formats import extract_scene
from factory.scenes.importer import Extraction
from factory.scenes.importer.extract import extract_stage
from factory.scenes.rules import builtin_rules
from factory.scenes.targets.candidates import (
    Candidate,
    find_candidates,
    find_copies,
    find_sections,
    footprint_width,
    joined,
)
from tests.builders.stage import StageText, Vector3

TEXT = StageText()


def box(name: str, at: float = 0.0, size: float = 0.8, colour: Vector3 = (0.5, 0.5, 0.5)) -> str:
    return TEXT.box(name, (at, 0, 0), (at + size, size, size), colour)


def found(tmp_path: Path, body: str) -> list[tuple[str, str]]:
    return candidates_of(extract_stage(TEXT.write(tmp_path / "scene.usda", body)))


def candidates_of(extraction: Extraction) -> list[tuple[str, str]]:
    book = load_textures({}, lambda path: None)
    candidates = find_candidates(extraction, extraction.parts, builtin_rules(), lambda own: target_colour(own, book))
    return [(candidate.path.removeprefix("/World/"), candidate.category) for candidate in candidates]


def test_the_outermost_match_is_the_target(tmp_path: Path) -> None:
    rack = TEXT.group("SM_RackPile_04", box("Frame") + box("SM_CratePlastic_01", 0.2, 0.5))
    assert found(tmp_path, rack) == [("SM_RackPile_04", "rack")]


def test_a_container_of_adjacent_objects_is_searched(tmp_path: Path) -> None:
    chairs = TEXT.group("Chairs", box("Chair_1", 0) + box("Chair_2", 1.0))
    assert found(tmp_path, chairs) == [("Chairs/Chair_1", "chair"), ("Chairs/Chair_2", "chair")]


def test_movable_parts_of_an_object_are_not_separate_objects(tmp_path: Path) -> None:
    def link(name: str, x: float, parent: str = "") -> str:
        shape = f'<visual><origin xyz="{x} 0 0.4"/><geometry><box size="0.6 0.4 0.8"/></geometry></visual>'
        ends = f'<parent link="{parent}"/><child link="{name}"/>'
        return f'<link name="{name}">{shape}</link>' + (
            f'<joint name="to_{name}" type="prismatic">{ends}</joint>' if parent else ""
        )

    drawers = "".join(link(f"cabinet1_drawer_{number}", number, "cabinet1") for number in range(2))
    path = tmp_path / "kitchen.urdf"
    path.write_text(f'<robot name="kitchen">{link("cabinet1", 0)}{drawers}{link("table", 5)}</robot>')
    assert candidates_of(extract_scene(path)) == [("cabinet1", "cabinet"), ("table", "table")]


def test_stacked_boards_are_one_shelf(tmp_path: Path) -> None:
    boards = "".join(TEXT.box(f"Shelf_{z}", (0, 0, z * 0.5), (1, 0.4, z * 0.5 + 0.05)) for z in range(4))
    assert found(tmp_path, TEXT.group("Bookcase", boards)) == [("Bookcase", "shelf")]


@pytest.mark.parametrize("head", ['kind = "group"', 'kind = "assembly"'])
def test_prims_of_the_kinds_group_and_assembly_are_searched(tmp_path: Path, head: str) -> None:
    assert found(tmp_path, TEXT.group("Table_Area", box("Desk_1"), head=head)) == [("Table_Area/Desk_1", "table")]


def test_scopes_are_searched(tmp_path: Path) -> None:
    assert found(tmp_path, TEXT.group("Tables", box("Desk_1"), kind="Scope")) == [("Tables/Desk_1", "table")]


def test_prims_below_a_component_are_not_separate_objects(tmp_path: Path) -> None:
    stand = TEXT.group("SM_Gadget", box("Table_top"), head='kind = "component"')
    assert found(tmp_path, stand) == []


def test_prims_of_implausible_size_are_not_objects_but_may_contain_objects(tmp_path: Path) -> None:
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


PALE, WOOD = (0.85, 0.85, 0.82), (0.35, 0.18, 0.07)


@pytest.mark.parametrize(
    ("size", "colour", "expected"),
    [
        ((1.8, 0.05, 1.2), PALE, "whiteboard"),
        ((0.05, 1.2, 0.9), PALE, "whiteboard"),
        ((3.0, 0.02, 0.15), WOOD, None),
        ((3.0, 0.02, 0.15), PALE, None),
        ((1.8, 0.05, 1.2), WOOD, None),
        ((1.8, 1.2, 0.05), PALE, None),
        ((1.8, 0.6, 1.2), PALE, None),
    ],
    ids=["panel", "panel across", "plank", "pale plank", "wooden panel", "lying panel", "block"],
)
def test_a_board_is_a_whiteboard_only_as_a_pale_upright_panel(
    tmp_path: Path, size: Vector3, colour: Vector3, expected: str | None
) -> None:
    body = TEXT.box("Board_01", (0, 0, 1), (size[0], size[1], 1 + size[2]), colour)
    assert found(tmp_path, body) == ([("Board_01", expected)] if expected else [])


@pytest.mark.parametrize("degrees", [0, 30, 45, 123])
def test_the_width_of_a_footprint_does_not_depend_on_its_rotation(degrees: float) -> None:
    turn = np.radians(degrees)
    corners = np.array([(0, 0), (2, 0), (2, 0.1), (0, 0.1), (1, 0.05), (1, 0)])
    turned = corners @ np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    upright = np.column_stack((turned, np.arange(6))).reshape(2, 3, 3)
    assert footprint_width(upright) == pytest.approx(0.1, abs=3e-4)
    assert footprint_width(upright[:1] * (1, 0, 1)) == pytest.approx(0.0, abs=1e-6)


def test_a_bed_needs_a_plausible_size_and_may_be_named_by_a_synonym(tmp_path: Path) -> None:
    sizes = {
        "Fridge": (0.7, 0.7, 1.8),
        "TV_01": (1.2, 0.1, 0.7),
        "BunkBed": (2.0, 1.0, 1.7),
        "Bed_Toy": (0.2, 0.1, 0.1),
    }
    body = "".join(
        TEXT.box(name, (5.0 * k, 0, 0), (5.0 * k + s[0], s[1], s[2])) for k, (name, s) in enumerate(sizes.items())
    )
    assert sorted(found(tmp_path, body)) == [("BunkBed", "bed"), ("Fridge", "refrigerator"), ("TV_01", "television")]


def test_a_name_that_fits_only_a_later_rule_by_shape_gets_the_category_of_this_rule(tmp_path: Path) -> None:
    assert found(tmp_path, TEXT.box("BedsideTable", (0, 0, 0), (1.8, 0.6, 0.7))) == [("BedsideTable", "table")]


def placed(path: str, category: str, shift_m: float, size: tuple[float, float, float] = (2.0, 0.9, 0.8)) -> Candidate:
    low = np.full(3, shift_m)
    return Candidate(path, category, np.stack([low, low + size]))


def test_candidates_of_one_category_at_one_place_are_copies_of_the_first() -> None:
    first, copy, third = (placed(f"/{name}", "sofa", shift) for name, shift in (("a", 0.0), ("b", 0.02), ("c", 0.01)))
    assert find_copies([first, copy, third]) == {"/b": "/a", "/c": "/a"}


def test_neighbours_and_candidates_of_other_categories_are_no_copies() -> None:
    first = placed("/a", "sofa", 0.0)
    assert find_copies([first, placed("/b", "sofa", 0.3)]) == {}
    assert find_copies([first, placed("/b", "bed", 0.0)]) == {}
    assert find_copies([first, placed("/b", "sofa", 0.0, (1.0, 0.9, 0.8))]) == {}


def test_a_couch_of_three_links_is_one_sofa(tmp_path: Path) -> None:
    def link(name: str, x: float) -> str:
        shape = '<visual><origin xyz="0 0 0.4"/><geometry><box size="0.8 0.9 0.8"/></geometry></visual>'
        joint = f'<joint name="j_{name}" type="fixed"><parent link="base"/><child link="{name}"/>'
        return f'<link name="{name}">{shape}</link>{joint}<origin xyz="{x} 0 0"/></joint>'

    links = "".join(link(f"couch_{name}", 0.8 * k) for k, name in enumerate(("left", "middle", "right")))
    chairs = "".join(link(f"chair_{k}", 5 + 0.8 * k) for k in range(2))
    path = tmp_path / "room.urdf"
    path.write_text(f'<robot name="room"><link name="base"/>{links}{chairs}</robot>')
    extraction = extract_scene(path)
    book = load_textures({}, lambda path: None)
    candidates = find_candidates(extraction, extraction.parts, builtin_rules(), lambda own: target_colour(own, book))
    sections = find_sections(candidates)
    assert sections == {"/World/couch_middle": "/World/couch_left", "/World/couch_right": "/World/couch_left"}
    *seats, couch = joined(candidates, sections)
    assert np.allclose(couch.box, [[-0.4, -0.45, 0.0], [2.0, 0.45, 0.8]])
    assert [seat.category for seat in seats] == ["chair", "chair"]


def test_only_touching_parts_with_names_of_parts_are_joined() -> None:
    size = (0.8, 0.9, 0.8)
    seat, back = (placed(f"/chair_{name}", "chair", 0.0, size) for name in ("seat", "back"))
    assert find_sections([back, seat]) == {"/chair_seat": "/chair_back"}
    assert find_sections([placed("/chair_left", "chair", 0.0, size), placed("/chair_right", "chair", 0.5, size)]) == {}
    assert find_sections([placed("/sofa_left", "sofa", 0.0, size), placed("/sofa_right", "sofa", 0.83, size)]) == {}
    assert find_sections([placed("/sofa_blue", "sofa", 0.0, size), placed("/sofa_red", "sofa", 0.5, size)]) == {}
    assert find_sections([placed("/a/sofa_1", "sofa", 0.0, size), placed("/b/sofa_2", "sofa", 0.5, size)]) == {}


def test_an_appliance_inside_one_of_its_category_is_its_part_and_a_table_in_the_corner_of_a_desk_is_not() -> None:
    area = placed("/fridge_area", "refrigerator", 0.0, (0.7, 0.7, 1.6))
    inner = placed("/iai_main", "refrigerator", 0.02, (0.66, 0.66, 1.0))
    assert find_sections([area, inner]) == {"/iai_main": "/fridge_area"}
    assert find_sections([placed("/desk_l", "table", 0.0), placed("/table", "table", 0.1, (0.5, 0.5, 0.5))]) == {}
    assert find_sections([area, placed("/fridge_2", "refrigerator", 0.5, (0.7, 0.7, 1.6))]) == {}
