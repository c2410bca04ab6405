"""MJCF has the meaning that MuJoCo gives it: the compiled model is the judge."""

from __future__ import annotations

from pathlib import Path

import pytest

from factory.scenes.formats import extract_scene
from factory.scenes.importer import Extraction
from schemas.errors import WorldError

mujoco = pytest.importorskip("mujoco")
MESH = "v -0.6 -0.4 0\nv 0.6 -0.4 0\nv 0 0.4 0\nv 0 0 0.8\nf 3 2 1\nf 1 2 4\nf 2 3 4\nf 3 1 4\n"
PARTS = '<include file="parts/a.xml"/>'
GEOM = '<worldbody><body name="table"><geom type="mesh" mesh="table"/></body></worldbody>'
ASSET = '<asset><mesh name="table" file="table.obj"/></asset>'


def write(path: Path, content: str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(content)
    return path


@pytest.mark.parametrize(
    ("main", "part"),
    [
        ('<include file="parts/a.xml"/><compiler meshdir="meshes"/>', f'<compiler meshdir="elsewhere"/>{ASSET}'),
        (f'<compiler meshdir="elsewhere"/>{ASSET}<include file="parts/a.xml"/>', '<compiler meshdir="meshes"/>'),
        (f'<compiler meshdir="x"/><compiler assetdir="meshes"/>{ASSET}', ""),
        ('<include file="parts/a.xml"/>', ASSET.replace("table.obj", "../meshes/table.obj")),
        ('<include file="parts/a.xml"/>', '<include file="b.xml"/>'),
        (
            '<compiler strippath="true" meshdir="meshes"/><include file="parts/a.xml"/>',
            ASSET.replace('"table.obj', '"c/table.obj'),
        ),
    ],
)
def test_files_are_found_where_mujoco_finds_them(tmp_path: Path, main: str, part: str) -> None:
    write(tmp_path / "meshes" / "table.obj", MESH)
    write(tmp_path / "parts" / "a.xml", f"<mujoco>{part}</mujoco>")
    write(tmp_path / "parts" / "b.xml", f"<mujoco>{ASSET.replace('table.obj', 'meshes/table.obj')}</mujoco>")
    path = write(tmp_path / "room.xml", f"<mujoco>{main}{GEOM}</mujoco>")
    assert mujoco.MjModel.from_xml_path(str(path)).nmesh == 1
    assert len(extract_scene(path).parts) == 1


def test_the_first_compiler_does_not_apply_after_another(tmp_path: Path) -> None:
    write(tmp_path / "meshes" / "table.obj", MESH)
    compilers = '<compiler meshdir="meshes"/><compiler meshdir="elsewhere"/>'
    path = write(tmp_path / "room.xml", f"<mujoco>{compilers}{ASSET}{GEOM}</mujoco>")
    with pytest.raises(ValueError, match=r"elsewhere/table\.obj"):
        mujoco.MjModel.from_xml_path(str(path))
    with pytest.raises(WorldError, match=r"files missing.*elsewhere/table\.obj \(of mesh table\)"):
        extract_scene(path)


def shown(extraction: Extraction) -> set[str]:
    return {part.path.rpartition("/")[2] for part in extraction.parts if not part.is_collider}


ROOM = """<mujoco><worldbody><body name="room">
    <geom name="floor" type="plane" size="3 3 .1"/>
    <geom name="north" type="box" size="3 .05 1.2" pos="0 3 1.2"/>
    <geom name="lamp" type="cylinder" size=".1 .1" pos="2 2 1.5" group="1" contype="0" conaffinity="0"/>
    <geom name="south" type="box" size="3 .05 1.2" pos="0 -3 1.2" contype="0" conaffinity="0"/>
    <geom name="shell" type="box" size=".1 .1 .12" pos="2 2 1.5"/></body></worldbody></mujoco>"""


def test_a_decoration_hides_only_the_colliding_geoms_that_it_encloses(tmp_path: Path) -> None:
    extraction = extract_scene(write(tmp_path / "room.xml", ROOM))
    assert shown(extraction) == {"floor", "north", "lamp", "south"}
    assert [part.path for part in extraction.parts if part.is_collider] == ["/World/room/shell"]
