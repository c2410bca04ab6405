"""Encoding and decoding of baked light and of the sky in compiled scenes."""

from __future__ import annotations

import io
import json
from dataclasses import replace

import numpy as np
import pytest

from schemas.errors import InvalidBundle
from schemas.scene import MAX_LIGHT_MAP_PX, CompiledScene, SceneInfo, Sky, decode_scene, encode_scene
from schemas.terms import SuccessMeasure
from tests.builders.scene import box_room


def lit_room(shape: tuple[int, int] = (8, 16)) -> CompiledScene:
    room = box_room()
    light = np.arange(shape[0] * shape[1] * 3).reshape(*shape, 3) % 251
    uvs = np.full((len(room.positions), 2), 0.25, np.float32)
    return replace(room, light_uvs=uvs, light_map=light.astype(np.uint8))


def again(scene: CompiledScene) -> CompiledScene:
    return decode_scene(io.BytesIO(encode_scene(scene)))


def test_light_is_stored_in_the_package() -> None:
    scene = lit_room()
    assert (again(scene).light_map == scene.light_map).all()
    assert (again(scene).light_uvs == scene.light_uvs).all()


def test_a_scene_may_have_no_light() -> None:
    assert again(box_room()).light_map.shape == (0, 0, 3)


def test_light_without_coordinates_for_each_vertex_is_refused() -> None:
    with pytest.raises(InvalidBundle, match="light_uvs"):
        again(replace(lit_room(), light_uvs=np.empty((0, 2), np.float32)))


def test_coordinates_outside_the_light_map_are_refused() -> None:
    scene = lit_room()
    with pytest.raises(InvalidBundle, match="light_uvs"):
        again(replace(scene, light_uvs=scene.light_uvs + 1))


def test_a_light_map_beyond_its_limit_is_refused() -> None:
    with pytest.raises(InvalidBundle, match="light map"):
        again(lit_room((1, MAX_LIGHT_MAP_PX + 1)))


def test_a_sky_is_stored_and_a_package_without_one_does_not_name_it() -> None:
    closed, opened = box_room(), replace(box_room(), info=box_room().info.model_copy(update={"sky": Sky()}))
    assert again(opened).info.sky == Sky()
    assert again(closed).info.sky is None
    assert (b'"sky"' in encode_scene(opened), b'"sky"' in encode_scene(closed)) == (True, False)


def test_a_package_of_format_2_is_read_without_footprints() -> None:
    room = box_room()
    bare = {"footprint_m": (), "surface_straight_tiers": (), "surface_connected_tiers": ()}
    targets = tuple(target.model_copy(update=bare) for target in room.info.targets)
    info = room.info.model_copy(update={"format": 2, "targets": targets})
    written = SceneInfo.model_validate_json(_without(info.model_dump_json(), *bare))
    found = again(replace(room, info=written)).info
    assert (found.format, found.has_footprints, room.info.has_footprints) == (2, False, True)
    assert found.targets[0].tiers(SuccessMeasure.SURFACE, by_path=True) == ()
    with pytest.raises(InvalidBundle, match="scene format 1"):
        again(replace(room, info=info.model_copy(update={"format": 1})))


def _without(text: str, *fields: str) -> str:
    data = json.loads(text)
    data["targets"] = [{key: value for key, value in row.items() if key not in fields} for row in data["targets"]]
    return json.dumps(data)
