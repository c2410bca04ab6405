"""Compilation of a stage to a scene package, or an error with the reason."""

from __future__ import annotations

import io
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from factory.scenes.build import build_scene, import_scene, package_path
from factory.scenes.compile.compiler import compile_stage
from factory.scenes.limits import StageLimits
from factory.scenes.topdown import draw_topdown
from schemas.errors import UsageError, WorldError
from schemas.scene import CompiledScene, Sky, decode_scene, encode_scene
from schemas.terms import Tier
from tests.builders.stage import StageText, room_body
from workers.geometry.grid import Grid

TEXT = StageText()


def room(tmp_path: Path, things: str = "", text: StageText = TEXT) -> CompiledScene:
    return compile_stage(text.write(tmp_path / "room.usda", room_body(text, things)), "room", "test")


def test_a_room_compiles_to_a_valid_package(tmp_path: Path) -> None:
    scene = room(tmp_path)
    data = encode_scene(scene)
    assert encode_scene(decode_scene(io.BytesIO(data))) == data


def test_the_chair_is_the_only_target_and_is_reached_from_every_tier(tmp_path: Path) -> None:
    (target,) = room(tmp_path).info.targets
    assert target.target_id == "chair_001"
    assert target.centroid_m == pytest.approx((2.0, 1.0, 0.45))
    assert target.size_m == pytest.approx((0.4, 0.4, 0.9))
    assert target.colour == "red"
    assert target.straight_tiers == target.connected_tiers == (Tier.NEAR, Tier.MID, Tier.FAR)


def covered(tmp_path: Path, things: str, ceiling_m: float | None = None) -> CompiledScene:
    stage = TEXT.write(tmp_path / "room.usda", room_body(TEXT, things))
    return compile_stage(stage, "room", "test", limits=StageLimits(ceiling_m=ceiling_m))


def test_an_open_stage_has_a_sky_and_a_closed_one_has_none(tmp_path: Path) -> None:
    roof = TEXT.box("Roof", (-4.2, -3.2, 2.5), (4.2, 3.2, 2.6))
    half = TEXT.box("Roof", (-4.2, -3.2, 2.5), (0.0, 3.2, 2.6))
    skies = [covered(tmp_path, things).info.sky for things in ("", half, roof)]
    assert skies == [Sky(), Sky(), None]


def test_a_ceiling_closes_an_open_stage_at_its_height_above_the_floor(tmp_path: Path) -> None:
    bare, scene = covered(tmp_path, ""), covered(tmp_path, "", 2.4)
    assert scene.info.sky is None
    (ceiling,) = (item for item in scene.info.instances if item.prim_path == "/AddedCeiling")
    (part,) = np.flatnonzero(scene.part_instance == ceiling.id)
    corners = scene.positions[scene.part_first[part] :][: scene.part_count[part]].reshape(-1, 3, 3)
    assert corners[..., 2] == pytest.approx(scene.info.floor_height_m + 2.4)
    assert (np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2] < 0).all()
    assert np.ptp(corners[..., :2], axis=(0, 1)) == pytest.approx((8.4, 6.4), abs=1e-3)
    assert (scene.occupancy == bare.occupancy).all()
    assert [target.straight_tiers for target in scene.info.targets] == [t.straight_tiers for t in bare.info.targets]


def test_centimetres_and_y_up_compile_to_the_same_scene(tmp_path: Path) -> None:
    plain, other = room(tmp_path), room(tmp_path, text=StageText(0.01, "Y"))
    assert plain.info.targets == other.info.targets
    assert (plain.occupancy == other.occupancy).all()
    assert np.allclose(plain.spawns, other.spawns, atol=1e-4)


def test_the_same_stage_gives_the_same_bytes(tmp_path: Path) -> None:
    assert encode_scene(room(tmp_path)) == encode_scene(room(tmp_path))


def test_parts_cover_all_vertices_once_and_belong_to_known_instances(tmp_path: Path) -> None:
    scene = room(tmp_path)
    ends = scene.part_first + scene.part_count
    assert scene.part_first.tolist() == [0, *ends[:-1].tolist()]
    assert ends[-1] == len(scene.positions)
    assert {int(number) for number in scene.part_instance} == {item.id for item in scene.info.instances}


def test_spawns_fit_and_are_spread(tmp_path: Path) -> None:
    scene = room(tmp_path)
    grid = Grid.from_scene(scene)
    assert len(scene.spawns) >= 40
    assert (grid.clearance_at(scene.spawns) > 0.25).all()
    assert np.ptp(scene.spawns, axis=0) == pytest.approx([7.0, 5.0], abs=0.7)


def test_no_spawn_is_below_a_shelf_on_legs(tmp_path: Path) -> None:
    scene = room(tmp_path, TEXT.box("SM_ShelfSteel_A", (-3, -2, 1.5), (0, 2, 1.7)))
    assert "shelf" in {target.category for target in scene.info.targets}
    assert Grid.from_scene(scene).clearance_at(np.array([[-1.5, 0.0]]))[0] > 1  # the floor below the shelf is free
    beneath = (scene.spawns > (-3, -2)) & (scene.spawns < (0, 2))
    assert not beneath.all(axis=1).any()


def test_an_object_on_a_wall_is_visible_only_from_its_side_of_the_wall(tmp_path: Path) -> None:
    wall = TEXT.box("Divider", (-0.1, -1.5, 0), (0, 3, 2.5)) + TEXT.box("SM_Board", (0.0, 1.0, 0.9), (0.04, 2.0, 1.6))
    scene = room(tmp_path, wall)
    column = [target.category for target in scene.info.targets].index("whiteboard")
    seeing = scene.spawns[scene.spawn_sees[:, column] == 1]
    assert len(seeing) > 0
    assert (seeing[:, 0] > 0).all()


def test_an_enclosed_object_is_not_a_target_but_stays_an_instance(tmp_path: Path) -> None:
    cell = (
        TEXT.box("CellA", (-3.6, -2.6, 0), (-3.5, -0.5, 2.5))
        + TEXT.box("CellB", (-1.5, -2.6, 0), (-1.4, -0.5, 2.5))
        + TEXT.box("CellC", (-3.6, -0.6, 0), (-1.4, -0.5, 2.5))
        + TEXT.box("CellD", (-3.6, -2.6, 0), (-1.4, -2.5, 2.5))
        + TEXT.box("SM_Crate_01", (-2.7, -1.8, 0), (-2.3, -1.4, 0.4))
    )
    scene = room(tmp_path, cell)
    assert [target.category for target in scene.info.targets] == ["chair"]
    assert any("crate_001" in note for note in scene.info.notes)
    assert "crate" in {item.category for item in scene.info.instances}


def test_distant_outliers_are_omitted_with_a_note(tmp_path: Path) -> None:
    scene = room(tmp_path, TEXT.box("Book", (0, 0, 343582), (1, 1, 343583)))
    assert scene.info.bounds_m[1][2] < 10
    assert any("Book" in note for note in scene.info.notes)


def test_glass_is_solid_but_not_rendered(tmp_path: Path) -> None:
    glass = """
    def Material "Glass" {
        token outputs:surface.connect = </World/Glass/Shader.outputs:surface>
        def Shader "Shader" {
            uniform token info:id = "UsdPreviewSurface"
            float inputs:opacity = 0.1
            token outputs:surface
        }
    }
    """
    pane = TEXT.box("Pane", (-2, 0, 0), (-1, 0.1, 2), more="rel material:binding = </World/Glass>")
    pane = pane.replace('def Cube "Pane"', 'def Cube "Pane" (prepend apiSchemas = ["MaterialBindingAPI"])')
    scene = room(tmp_path, glass + pane)
    assert not any("Pane" in item.prim_path for item in scene.info.instances)
    assert Grid.from_scene(scene).clearance_at((-1.5, 0.05)) < 0.1


def test_the_top_down_picture_has_a_block_of_pixels_for_each_cell(tmp_path: Path) -> None:
    scene = room(tmp_path)
    picture = draw_topdown(scene, pixels_per_cell=2)
    assert picture.shape == (2 * scene.occupancy.shape[0], 2 * scene.occupancy.shape[1], 3)


def test_textures_are_upright_in_the_package(tmp_path: Path) -> None:
    halves = np.zeros((8, 8, 3), np.uint8)
    halves[:4], halves[4:] = (200, 0, 0), (0, 0, 200)
    Image.fromarray(halves).save(tmp_path / "halves.png")
    poster = """
    def Material "Print" {
        token outputs:surface.connect = </World/Print/Shader.outputs:surface>
        def Shader "Shader" {
            uniform token info:id = "UsdPreviewSurface"
            color3f inputs:diffuseColor.connect = </World/Print/Image.outputs:rgb>
            token outputs:surface
        }
        def Shader "Image" {
            uniform token info:id = "UsdUVTexture"
            asset inputs:file = @halves.png@
            float3 outputs:rgb
        }
    }
    def Mesh "Poster" (prepend apiSchemas = ["MaterialBindingAPI"]) {
        int[] faceVertexCounts = [4]
        int[] faceVertexIndices = [0, 1, 2, 3]
        point3f[] points = [(-1, 2.9, 1), (1, 2.9, 1), (1, 2.9, 2), (-1, 2.9, 2)]
        texCoord2f[] primvars:st = [(0, 0), (1, 0), (1, 1), (0, 1)] (interpolation = "vertex")
        uniform token subdivisionScheme = "none"
        rel material:binding = </World/Print>
    }
    """
    scene = room(tmp_path, poster)
    (row,) = np.flatnonzero(scene.part_texture == 0)
    run = slice(scene.part_first[row], scene.part_first[row] + scene.part_count[row])
    assert (scene.uvs[run][:, 1] == (scene.positions[run][:, 2] > 1.5)).all()
    assert scene.textures[0][0, 0, 0] > 150


@pytest.mark.parametrize(
    ("body", "message"),
    [
        ('def Xform "Empty" {\n}\n', "contains no visible mesh"),
        (TEXT.box("Wall", (0, 0, 0), (5, 0.1, 3)), "no floor"),
        (TEXT.box("Floor", (0, 0, -0.1), (8, 8, 0)), "no instance of a known category among 1 objects"),
        (TEXT.box("Floor", (0, 0, -0.1), (8, 8, 0)) + TEXT.box("Chair", (20, 20, 0), (20.5, 20.5, 1)), "no reachable"),
    ],
)
def test_an_unusable_stage_is_refused_with_the_reason(tmp_path: Path, body: str, message: str) -> None:
    path = TEXT.write(tmp_path / "odd.usda", body)
    with pytest.raises(WorldError, match=message) as caught:
        compile_stage(path, "odd", "test")
    assert "odd.usda" in str(caught.value) or "floor" in str(caught.value)


def test_an_imported_package_is_named_by_its_content(tmp_path: Path) -> None:
    stage = TEXT.write(tmp_path / "room.usda", room_body(TEXT))
    path = import_scene(stage, "my_room", tmp_path / "cache")
    assert path == import_scene(stage, "my_room", tmp_path / "cache")
    assert [file.name for file in (tmp_path / "cache").glob("*.scene.zip")] == [path.name]
    with path.open("rb") as file:
        assert decode_scene(file).info.name == "my_room"


@pytest.mark.parametrize("name", ["My Room", "office", "", "9lives"])
def test_invalid_scene_names_are_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(UsageError, match="name"):
        import_scene(tmp_path / "room.usda", name, tmp_path)


def test_the_error_of_an_unknown_builtin_scene_lists_the_known_scenes(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="full_warehouse"):
        build_scene("castle", 0, tmp_path)


def test_package_paths_differ_by_name_and_seed(tmp_path: Path) -> None:
    paths = {package_path(name, seed, tmp_path) for name in ("office", "hospital") for seed in (0, 1)}
    assert len(paths) == 4


def test_a_cache_that_cannot_be_written_is_reported(tmp_path: Path) -> None:
    (tmp_path / "cache").write_text("a file")
    stage = TEXT.write(tmp_path / "room.usda", room_body(TEXT))
    with pytest.raises(WorldError, match="cannot write"):
        import_scene(stage, "my_room", tmp_path / "cache")


def test_a_stage_far_from_its_origin_is_refused(tmp_path: Path) -> None:
    site = TEXT.group("Site", room_body(TEXT), at=(400000, 0, 0))
    with pytest.raises(WorldError, match="origin"):
        compile_stage(TEXT.write(tmp_path / "site.usda", site), "site", "test")


def test_reading_the_cache_does_not_load_usd() -> None:
    code = "import sys, factory.scenes; raise SystemExit('pxr' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_a_table_whose_centre_is_out_of_reach_is_a_target_by_its_footprint(tmp_path: Path) -> None:
    scene = room(tmp_path, TEXT.box("SM_KitchenTable", (-3.0, -1.4, 0.0), (-0.2, 1.2, 0.75)))
    table = next(target for target in scene.info.targets if target.category == "table")
    assert set(table.footprint_m) == {(-3.0, -1.4), (-0.2, -1.4), (-0.2, 1.2), (-3.0, 1.2)}
    assert table.straight_tiers == table.connected_tiers == ()
    assert Tier.NEAR in table.surface_straight_tiers
    assert Tier.NEAR in table.surface_connected_tiers
