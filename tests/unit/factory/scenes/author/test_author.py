"""The authored scenes: reproducibility, categories, units, names, references and closed shells."""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator
from itertools import combinations
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from PIL import Image

from factory.scenes.author.drawn import draw_pixels
from factory.scenes.author.geometry import bounds, triangle_count
from factory.scenes.author.materials import PropPiece
from factory.scenes.author.placement import FloorPlan
from factory.scenes.author.props.catalogue import CATALOGUE, PropBuilder
from factory.scenes.author.scene import (
    AUTHOR_VERSION,
    BUILTIN_SCENES,
    PAPER_LAYOUTS,
    BuiltinScene,
    author_content,
    author_scene,
    lay_out_scene,
)
from factory.scenes.importer import TextureRecipe
from factory.scenes.rules import builtin_rules
from schemas.errors import WorldError
from schemas.terms import BUILTIN_CATEGORIES, CATEGORIES, PAPER_SCENES
from tests.builders.layouts import Layouts

pxr_usd = pytest.importorskip("pxr.Usd")
pxr_geom = pytest.importorskip("pxr.UsdGeom")

NAME_RULES = {
    "fire_extinguisher": r"^SM_FireExtinguisher",
    "whiteboard": r"^SM_Whiteboard",
    "trash_can": r"^SM_TrashCan",
    "monitor": r"^SM_Monitor",
    "chair": r"^SM_(Chair|Stool)",
    "sofa": r"^SM_Sofa",
    "table": r"^SM_Table",
    "plant": r"^SM_Plant",
    "barrel": r"^SM_Barel",
    "crate": r"^SM_Crate",
    "rack": r"^SM_Rack",
    "shelf": r"^SM_Shelf",
}
TARGET_WORDS = re.compile(
    r"(?i)(?<!wheel)chair|stool|sofa|couch|table|desk|monitor|plant|trash|extinguisher|shel[fv]|rack|barr?el|crate"
)


SHELVES = BUILTIN_SCENES["warehouse_multiple_shelves"]


def count_categories(plan: FloorPlan) -> Counter[str]:
    return Counter(
        category
        for placement in plan.placements
        for category, rule in NAME_RULES.items()
        if re.match(rule, placement.name)
    )


@pytest.fixture(scope="module")
def office(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return author_scene(PAPER_LAYOUTS["office"], 0, tmp_path_factory.mktemp("office"))


@pytest.fixture(scope="module")
def shelves(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return author_scene(SHELVES, 7, tmp_path_factory.mktemp("shelves"))


def read_meshes(path: Path) -> dict[str, np.ndarray]:
    stage = pxr_usd.Stage.Open(str(path))
    cache = pxr_geom.XformCache()
    meshes = {}
    for prim in pxr_usd.PrimRange(stage.GetPseudoRoot(), pxr_usd.TraverseInstanceProxies(pxr_usd.PrimDefaultPredicate)):
        if prim.IsA(pxr_geom.Mesh):
            points = np.array(pxr_geom.Mesh(prim).GetPointsAttr().Get())
            world = np.array(cache.GetLocalToWorldTransform(prim))
            meshes[str(prim.GetPath())] = points @ world[:3, :3] + world[3, :3]
    return meshes


@pytest.mark.parametrize("name", PAPER_SCENES)
def test_every_category_occurs_at_least_four_times_in_the_layout_of_the_paper(name: str) -> None:
    counts = count_categories(lay_out_scene(PAPER_LAYOUTS[name], 0))
    wanted = {*BUILTIN_CATEGORIES[name].seen, *BUILTIN_CATEGORIES[name].held_out}
    assert set(counts) == wanted
    assert min(counts.values()) >= 4


@pytest.mark.parametrize("name", PAPER_SCENES)
def test_layouts_have_their_built_in_categories_and_only_the_listed_others(name: str, layouts: Layouts) -> None:
    wanted = {*BUILTIN_CATEGORIES[name].seen, *BUILTIN_CATEGORIES[name].held_out}
    others: set[str] = set()
    for plan in layouts.of(name).values():
        counts = count_categories(plan)
        assert wanted <= set(counts)
        others |= set(counts) - wanted
    assert others == set(BUILTIN_SCENES[name].others)
    assert others <= set(CATEGORIES)


@pytest.mark.parametrize("name", BUILTIN_SCENES)
def test_scene_stays_below_its_triangle_budget(name: str, layouts: Layouts) -> None:
    plan = layouts.of(name)[0]
    pieces = [piece for structure in plan.structures for piece in structure.pieces]
    pieces += [piece for placement in plan.placements for piece in placement.model.pieces]
    assert sum(triangle_count(piece.mesh) for piece in pieces) < 62_000


def test_the_error_of_a_seed_without_a_valid_plan_names_the_last_fault_and_the_remedy() -> None:
    def lay_out(_plan: FloorPlan) -> None:
        raise WorldError("room for only 2 racks")

    scene = BuiltinScene("full_warehouse", "hall without a valid plan", lay_out)
    with pytest.raises(WorldError, match=r"none of 8 random.*room for only 2 racks; use another seed"):
        lay_out_scene(scene, 0)


def test_seeds_give_different_layouts(layouts: Layouts) -> None:
    first, second = layouts.of("hospital")[0], layouts.of("hospital")[1]
    assert [(p.name, p.x, p.y) for p in first.placements] != [(p.name, p.x, p.y) for p in second.placements]


def test_no_furniture_blocks_a_door() -> None:
    plan = lay_out_scene(PAPER_LAYOUTS["office"], 0)
    assert plan.kept_clear
    for placement in plan.placements:
        on_floor = placement.z == 0.0 and placement.model.low[2] < 0.5
        in_door = any(z.x0 < placement.x < z.x1 and z.y0 < placement.y < z.y1 for z in plan.kept_clear)
        assert not (on_floor and in_door), placement.name


def test_same_seed_writes_the_same_geometry_and_pixels(shelves: Path, tmp_path: Path) -> None:
    again = author_scene(SHELVES, 7, tmp_path)
    first, second = read_meshes(shelves), read_meshes(again)
    assert first.keys() == second.keys()
    assert all(np.array_equal(first[key], second[key]) for key in first)
    textures = sorted((shelves.parent / "textures").iterdir())
    assert textures
    assert all(file.read_bytes() == (tmp_path / "textures" / file.name).read_bytes() for file in textures)


def test_authoring_into_the_same_directory_replaces_the_scene(shelves: Path) -> None:
    before = read_meshes(shelves)
    other = read_meshes(author_scene(SHELVES, 1, shelves.parent))
    assert before.keys() != other.keys()
    assert read_meshes(author_scene(SHELVES, 7, shelves.parent)).keys() == before.keys()


def test_content_of_a_layout_equals_what_the_importer_reads_from_its_usd(office: Path) -> None:
    from factory.scenes.importer.extract import extract_stage

    imported, direct = extract_stage(office), author_content(PAPER_LAYOUTS["office"], 0)
    expected = {part.path: part for part in imported.parts}
    assert {part.path for part in direct.parts} == expected.keys()
    assert direct.models == imported.models
    assert direct.components == imported.components
    for part in direct.parts:
        other = expected[part.path]
        assert np.allclose(part.triangles, other.triangles, atol=1e-4), part.path
        assert (part.uvs is None) == (not other.surface.texture)
        assert part.uvs is None or np.allclose(part.uvs, other.uvs, atol=1e-4)
        assert Path(other.surface.texture).stem == part.surface.texture
        assert np.allclose(part.surface.colour, other.surface.colour, atol=1e-6)
        assert np.allclose(part.surface.emission, other.surface.emission, atol=1e-6)
        assert part.surface.emits == other.surface.emits
    for name, recipe in direct.images.items():
        assert isinstance(recipe, TextureRecipe)
        with Image.open(office.parent / "textures" / f"{name}.png") as written:
            assert np.array_equal(np.asarray(written), draw_pixels(recipe))


def test_office_is_authored_in_centimetres_and_z_up(office: Path) -> None:
    stage = pxr_usd.Stage.Open(str(office))
    assert pxr_geom.GetStageMetersPerUnit(stage) == 0.01
    assert pxr_geom.GetStageUpAxis(stage) == "Z"
    points = np.concatenate(list(read_meshes(office).values()))
    assert 2390 < np.ptp(points[:, 0]) < 2430
    assert 1590 < np.ptp(points[:, 1]) < 1630
    assert {scene.metres_per_unit for scene in BUILTIN_SCENES.values()} == {1.0}


def test_props_are_instances_payloads_and_plain_references_and_all_have_meshes(office: Path) -> None:
    stage = pxr_usd.Stage.Open(str(office))
    props = stage.GetPrimAtPath("/World/Props").GetChildren()
    assert {(prop.IsInstanceable(), prop.HasAuthoredPayloads()) for prop in props} == {
        (True, False),
        (False, True),
        (False, False),
    }
    meshes = read_meshes(office)
    assert all(any(key.startswith(f"{prop.GetPath()}/") for key in meshes) for prop in props)


def test_clutter_names_match_no_category_word() -> None:
    clutter = [name for name in CATALOGUE if not any(re.match(rule, name) for rule in NAME_RULES.values())]
    assert clutter
    assert not [name for name in clutter if TARGET_WORDS.search(name)]


def test_every_model_is_on_or_above_the_floor() -> None:
    props = PropBuilder(0)
    for name, entry in CATALOGUE.items():
        for variant in range(entry.variants):
            low, _ = bounds([piece.mesh for piece in props.model(name, variant).pieces])
            assert low[2] > -0.01, f"{name} variant {variant} reaches {low[2]:.3f} m"


def test_no_two_visible_materials_share_a_plane() -> None:
    """Such faces would flicker (z-fighting). Backs against a wall and undersides on the floor are not visible."""
    props, found = PropBuilder(0), []
    for name, entry in CATALOGUE.items():
        for variant in range(entry.variants):
            for plane, faces in faces_by_plane(props.model(name, variant).pieces).items():
                is_hidden = plane in {(1, 1, 0.0), (2, -1, 0.0)}
                for first, second in combinations(() if is_hidden else faces, 2):
                    if first.material != second.material:
                        overlap = np.minimum(first.high, second.high) - np.maximum(first.low, second.low)
                        found += [(name, variant, plane)] if overlap.min() > 1e-3 and overlap.prod() > 1e-4 else []
    assert found == []


class LevelFace(NamedTuple):
    """A face perpendicular to an axis: axis, direction and position; its rectangle along the other two axes, metres."""

    plane: tuple[int, int, float]
    material: str
    low: np.ndarray
    high: np.ndarray


def faces_by_plane(pieces: Iterable[PropPiece]) -> dict[tuple[int, int, float], list[LevelFace]]:
    found = defaultdict(list)
    for piece in pieces:
        for face in level_faces(piece):
            found[face.plane].append(face)
    return found


def level_faces(piece: PropPiece) -> Iterator[LevelFace]:
    ends = np.cumsum(piece.mesh.counts)
    starts = ends - piece.mesh.counts
    first, second, third = (piece.mesh.points[piece.mesh.indices[starts + number]] for number in range(3))
    normals = np.cross(second - first, third - first)
    axes = np.abs(normals).argmax(axis=1)
    along = np.take_along_axis(normals, axes[:, None], axis=1)[:, 0]
    is_level = (along != 0) & (np.abs(along) > 0.9999 * np.linalg.norm(normals, axis=1))
    for number in np.flatnonzero(is_level):
        corners, axis = piece.mesh.points[piece.mesh.indices[starts[number] : ends[number]]], int(axes[number])
        plane = (axis, int(np.sign(along[number])), round(float(corners[0, axis]), 4))
        others = [other for other in range(3) if other != axis]
        yield LevelFace(plane, piece.material.name, corners.min(axis=0)[others], corners.max(axis=0)[others])


def test_the_author_version_is_set() -> None:
    assert AUTHOR_VERSION


def test_home_shop_and_school_have_48_categories_with_three_different_variants_each() -> None:
    categories = {
        name for family in ("home", "shop", "school") for group in BUILTIN_CATEGORIES[family] for name in group
    }
    looks: dict[str, set[bytes]] = {name: set() for name in categories}
    props = PropBuilder(0)
    for name, entry in CATALOGUE.items():
        rule = builtin_rules().match(name)
        if rule is not None and rule.category in looks:
            for variant in range(entry.variants):
                pieces = props.model(name, variant).pieces
                shapes = b"".join(np.round(piece.mesh.points, 3).tobytes() for piece in pieces)
                looks[rule.category].add(shapes + repr([piece.material for piece in pieces]).encode())
    assert len(categories) == 48
    assert {name for name, different in looks.items() if len(different) < 3} == set()
