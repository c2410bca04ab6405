"""The sizes of doors, tables and chairs show whether a scene has its true size."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from factory.scenes.build import import_scene
from factory.scenes.formats import extract_scene
from factory.scenes.limits import StageLimits, Unit
from factory.scenes.targets.scale import scale_note
from schemas.errors import WorldError
from schemas.scene import read_info
from tests.builders.formats import CHAIR, QUADS, ROOM, Box, corners

TABLE = Box("Table_01", (-2.0, -1.0, 0.0), (-0.8, -0.2, 0.75))
DOOR = Box("Door", (3.9, -0.5, 0.0), (4.0, 0.4, 2.05))
CUPBOARD_DOOR = Box("cupboard_door_01", (3.0, 2.9, 0.0), (3.5, 3.0, 0.7))
BAR = Box("BarTable", (-2.0, -1.0, 0.0), (-0.8, -0.2, 1.1))


def room(folder: Path, scale: float, *things: Box) -> Path:
    lines, first = [], 1
    for box in (*ROOM, *things):
        lines += [f"o {box.name}", *("v " + " ".join(f"{value * scale:.6f}" for value in at) for at in corners(box))]
        lines += ["f " + " ".join(str(first + corner) for corner in quad) for quad in QUADS]
        first += 8
    path = folder / "room.obj"
    path.write_text("\n".join(lines))
    return path


def limits(unit: Unit = "m") -> StageLimits:
    return StageLimits(unit=unit, up="z")


PARTS = tuple(Box(f"Table_fragment_{k}", (-2.0, k, 0.7), (-0.8, k + 0.5, 0.72)) for k in range(3))


@pytest.mark.parametrize("things", [PARTS, (TABLE, *PARTS), (TABLE, DOOR), (TABLE,), (DOOR,), (BAR,), (CUPBOARD_DOOR,)])
def test_a_scene_of_true_size_has_no_note(tmp_path: Path, things: tuple[Box, ...]) -> None:
    assert scale_note(extract_scene(room(tmp_path, 1.0, *things), limits()), can_give_unit=True) == ""


@pytest.mark.parametrize(
    ("scale", "unit", "remedy"),
    [(0.667, "m", 1.5), (1.8, "m", 0.55), (100 / 2.54, "cm", "in"), (1.0, 0.3048, "m"), (3.28, "m", "0.3048")],
)
def test_a_wrong_scale_is_noted_with_a_unit_that_removes_it(
    tmp_path: Path, scale: float, unit: Unit, remedy: str | float
) -> None:
    path = room(tmp_path, scale, TABLE, DOOR)
    note = scale_note(extract_scene(path, limits(unit)), can_give_unit=True)
    assert "1 chair of" in note
    assert "1 door of" in note
    (given,) = re.findall(r"--unit (\S+)$", note)
    assert given == remedy or float(given) == pytest.approx(float(remedy), rel=0.04)
    again = float(given) if given not in ("m", "cm", "mm", "in") else given
    assert scale_note(extract_scene(path, limits(again)), can_give_unit=True) == ""  # type: ignore[arg-type]


def test_a_format_that_defines_its_unit_is_to_be_scaled_in_its_file(tmp_path: Path) -> None:
    note = scale_note(extract_scene(room(tmp_path, 0.5, TABLE, DOOR), limits()), can_give_unit=False)
    assert "scale it by 1.97 in its file" in note
    assert "metersPerUnit = 1.97" in note


def test_an_import_records_the_note_and_an_import_without_targets_prints_it(tmp_path: Path) -> None:
    package = import_scene(room(tmp_path, 0.667, TABLE, DOOR), "room", tmp_path / "cache", limits=limits())
    assert any("times its true size" in note for note in read_info(package).notes)
    tiny = room(tmp_path, 0.2, TABLE, CHAIR._replace(name="Chair_2"))
    with pytest.raises(WorldError, match=r"no instance of a known category.*times its true size.*--unit [45]"):
        import_scene(tiny, "tiny", tmp_path / "cache", limits=limits())
