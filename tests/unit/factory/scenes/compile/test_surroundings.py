"""Meshes that enclose a whole scene are taken as sky; closed buildings are not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from factory.scenes.build import import_scene
from factory.scenes.compile.surroundings import without_surroundings
from factory.scenes.importer import Part, Surface
from factory.scenes.importer.polygons import triangulate
from factory.scenes.importer.solids import Polygons, box, cylinder, plane, sphere, turned
from factory.scenes.limits import StageLimits
from schemas.scene import CompiledScene, decode_scene
from schemas.support.numpy_types import Floats


def faces(solid: Polygons, at: tuple[float, float, float] = (0, 0, 0), is_inside: bool = False) -> Floats:
    points, counts, indices = solid
    triangles = (points + at)[indices[triangulate(points, counts, indices).corners]]
    return triangles[:, ::-1] if is_inside else triangles


def above(triangles: Floats, height: float) -> Floats:
    return triangles[triangles[:, :, 2].min(axis=1) >= height - 1e-6]


def part(path: str, triangles: Floats, is_collider: bool = False) -> Part:
    return Part(path, triangles, uvs=None, tints=None, surface=Surface(), is_collider=is_collider)


ROOM = (
    part("/World/Floor", faces(plane(4, 3))),
    part("/World/North", faces(box(4, 0.1, 1.3), (0, 3, 1.3))),
    part("/World/South", faces(box(4, 0.1, 1.3), (0, -3, 1.3))),
    part("/World/East", faces(box(0.1, 3, 1.3), (4, 0, 1.3))),
    part("/World/West", faces(box(0.1, 3, 1.3), (-4, 0, 1.3))),
    part("/World/Table", faces(box(0.6, 0.4, 0.35), (1, 0, 0.35))),
)
GROUND = part("/World/Ground", faces(plane(60, 60)))
SKIES = {
    "a sphere of 20 m": faces(sphere(20)),
    "a sphere of 500 m": faces(sphere(500)),
    "a sphere seen from inside": faces(sphere(100), is_inside=True),
    "a sphere beside the origin": faces(sphere(60), (12, -20, 5)),
    "a sphere with both windings": np.concatenate([faces(sphere(80)), faces(sphere(80), is_inside=True)]),
    "a box": faces(box(50, 50, 50)),
    "a box seen from inside": faces(box(50, 40, 30), is_inside=True),
    "a hemisphere": above(faces(sphere(40)), 0.0),
    "a hemisphere with a bottom": np.concatenate([above(faces(sphere(40)), 0.0), faces(cylinder(40, 40, 0.0))]),
    "a cylinder": faces(cylinder(90, 90, 40)),
    "two spheres": np.concatenate([faces(sphere(50)), faces(sphere(52))]),
}


@pytest.mark.parametrize("kind", SKIES)
@pytest.mark.parametrize("ground", [(), (GROUND,)], ids=["room", "on ground"])
def test_a_mesh_around_everything_is_named_and_removed(kind: str, ground: tuple[Part, ...]) -> None:
    notes: list[str] = []
    shell = part("/World/Thing_7", SKIES[kind])
    kept, found = without_surroundings((*ROOM, *ground, shell), notes)
    assert found
    assert kept == (*ROOM, *ground)
    assert [note.partition(":")[0] for note in notes] == ["/World/Thing_7"]


def test_spheres_around_each_other_and_collision_shapes_are_removed() -> None:
    notes: list[str] = []
    sky = part("/World/Sky/Visual", faces(sphere(100)))
    physics = part("/World/Sky/Collision", faces(sphere(100)), is_collider=True)
    clouds = part("/World/Clouds", faces(sphere(60)))
    assert without_surroundings((*ROOM, sky, physics, clouds), notes) == (ROOM, True)
    assert len(notes) == 2


def test_the_sides_of_a_sky_box_may_be_separate_prims() -> None:
    sides = faces(box(8, 8, 8), (0, 0, 4)).reshape(6, 2, 3, 3)
    prims = tuple(part(f"/World/sky_{number}", side) for number, side in enumerate(sides))
    assert without_surroundings((*ROOM, *prims), []) == (ROOM, True)


TABLE = faces(box(0.6, 0.4, 0.35), (1, 0, 0.35))
WIDE_FLOOR = faces(plane(20, 20), (0, 0, 0.2))
WALLS = above(faces(box(12, 12, 8)), -8)
BUILDINGS = {
    "a room of one mesh": [faces(box(4, 3, 1.3), (0, 0, 1.3), is_inside=True), TABLE],
    "a high hall of one mesh": [faces(box(30, 20, 6), (0, 0, 6), is_inside=True), TABLE],
    "a high hall with a separate floor": [faces(box(20, 20, 6), (0, 0, 6), is_inside=True), WIDE_FLOOR, TABLE],
    "a hall with a floor above its foundation": [faces(box(20, 20, 6), (0, 0, 5)), faces(plane(19.8, 19.8)), TABLE],
    "a house on a ground plane": [faces(box(5, 5, 1.5), (0, 0, 1.5)), faces(plane(50, 50)), TABLE],
    "a hall without bottom on a ground plane": [
        faces(box(20, 20, 6), (0, 0, 6))[2:],
        faces(plane(50, 50)),
        TABLE,
    ],
    "a hangar on a ground plane": [
        above(faces(turned(cylinder(20, 20, 30), "X")), 0.0),
        faces(plane(80, 80)),
        TABLE,
    ],
    "a yurt on a ground plane": [above(faces(sphere(6)), 0.0), faces(plane(50, 50)), TABLE],
    "an atrium with a deep pit": [
        faces(box(20, 20, 6), (0, 0, 6), is_inside=True),
        faces(box(2, 2, 2), (8, 8, -2), is_inside=True),
        TABLE,
    ],
    "a mesh alone": [faces(sphere(50))],
}


@pytest.mark.parametrize("kind", BUILDINGS)
def test_a_closed_building_is_not_taken_as_sky(kind: str) -> None:
    parts = tuple(part(f"/World/Thing_{number}", triangles) for number, triangles in enumerate(BUILDINGS[kind]))
    notes: list[str] = []
    assert without_surroundings(parts, notes) == (parts, False)
    assert not notes


def obj_text(meshes: dict[str, Floats]) -> str:
    lines, count = [], 0
    for name, triangles in meshes.items():
        lines.append(f"o {name}")
        lines += [f"v {x:.5f} {y:.5f} {z:.5f}" for x, y, z in triangles.reshape(-1, 3)]
        lines += [
            f"f {3 * row + count + 1} {3 * row + count + 2} {3 * row + count + 3}" for row in range(len(triangles))
        ]
        count += 3 * len(triangles)
    return "\n".join(lines)


def imported(folder: Path, meshes: dict[str, Floats]) -> CompiledScene:
    folder.mkdir()
    path = folder / "room.obj"
    path.write_text(obj_text(meshes))
    with import_scene(path, "room", folder / "cache", limits=StageLimits(unit="m", up="z")).open("rb") as file:
        return decode_scene(file)


def test_a_room_in_a_sky_sphere_has_the_map_and_the_physics_of_the_room(tmp_path: Path) -> None:
    meshes = {part.path.rpartition("/")[2]: part.triangles for part in ROOM}
    plain = imported(tmp_path / "plain", meshes)
    scene = imported(tmp_path / "sky", meshes | {"Sphere001": faces(sphere(200), is_inside=True)})
    assert scene.info.floor_height_m == plain.info.floor_height_m == 0.0
    assert np.array_equal(scene.occupancy, plain.occupancy)
    assert np.array_equal(scene.collider_vertices, plain.collider_vertices)
    assert np.array_equal(scene.positions, plain.positions)
    assert scene.info.targets == plain.info.targets
    assert scene.info.sky is not None
    assert [note for note in scene.info.notes if "/World/Sphere001: encloses everything else" in note]
