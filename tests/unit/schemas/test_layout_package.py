"""Packages of format 4: their textures are separate files that several packages share, or members of a complete
package."""

from __future__ import annotations

import io
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from schemas.encoding.container import ContainerReader, ContainerWriter
from schemas.encoding.ndarray import encode_npy_zst
from schemas.errors import InvalidBundle
from schemas.scene import (
    LAYOUT_FORMAT,
    CompiledScene,
    TextureFile,
    decode_geometry,
    decode_scene,
    encode_layout,
    encode_scene,
    read_geometry,
    read_info,
    read_scene,
)
from schemas.scene.complete import complete_package, require_sound, split_package
from schemas.scene.files import copy_package, faulty_textures
from schemas.scene.package import PACKAGE_LIMITS, join_light, join_positions, split_light, split_positions
from tests.builders.layout_package import MadeLayout, layout_scene, make_layout
from tests.builders.scene import box_room

LAYOUT = make_layout("home_00001")


def members(data: bytes) -> dict[str, bytes]:
    reader = ContainerReader(io.BytesIO(data), PACKAGE_LIMITS)
    return {name: reader.read(name) for name in reader.names}


def packed(parts: dict[str, bytes]) -> io.BytesIO:
    buffer = io.BytesIO()
    with ContainerWriter(buffer) as out:
        for name, data in parts.items():
            out.add(name, data)
    return buffer


def assert_equal(one: CompiledScene, other: CompiledScene) -> None:
    for field in fields(CompiledScene):
        if field.name != "info":
            np.testing.assert_array_equal(getattr(one, field.name), getattr(other, field.name))


def lit(scene: CompiledScene) -> CompiledScene:
    light = np.random.default_rng(0).integers(0, 256, (7, 9, 3)).astype(np.uint8)
    return replace(scene, light_map=light, light_uvs=np.full((len(scene.positions), 2), 0.5, np.float32))


@pytest.mark.parametrize("scene", [layout_scene("home_00001"), lit(box_room())], ids=["textures", "light"])
def test_a_package_of_format_4_gives_the_same_scene(scene: CompiledScene) -> None:
    made = encode_layout(scene)
    found = decode_scene(io.BytesIO(made.data), made.textures.__getitem__)
    assert_equal(found, scene)
    assert found.info.format == LAYOUT_FORMAT
    assert encode_scene(found) == encode_scene(scene)
    assert encode_layout(found) == made


def test_layouts_list_shared_textures_by_one_digest() -> None:
    one, other = make_layout("home_00001", shades=(40, 200)), make_layout("home_00002", shades=(90, 200))
    assert len({*one.textures} & {*other.textures}) == 1
    assert b"textures" not in one.package[-2000:]


def test_the_scenes_of_a_process_share_decoded_layers() -> None:
    other = make_layout("home_00002", shades=(90, 200))
    first = decode_scene(io.BytesIO(LAYOUT.package), LAYOUT.textures.__getitem__)
    second = decode_scene(io.BytesIO(other.package), other.textures.__getitem__)
    assert first.textures[1] is second.textures[1]
    assert not first.textures[1].flags.writeable


def test_a_scene_without_pixels_needs_no_texture_and_cannot_be_encoded() -> None:
    scene = decode_geometry(io.BytesIO(LAYOUT.package))
    assert (scene.textures, scene.info.texture_count) == ((), 2)
    with pytest.raises(ValueError, match="without the pixels"):
        encode_scene(scene)
    assert decode_geometry(io.BytesIO(encode_scene(layout_scene("home_00001")))).textures == ()


def test_a_complete_package_is_decoded_without_other_files_and_split_into_the_same_bytes() -> None:
    complete = LAYOUT.complete()
    assert_equal(decode_scene(io.BytesIO(complete)), layout_scene("home_00001"))
    parts = split_package(io.BytesIO(complete))
    assert (parts.package, dict(parts.textures)) == (LAYOUT.package, dict(LAYOUT.textures))


def test_a_package_that_contains_its_textures_is_complete() -> None:
    data = encode_scene(box_room())
    assert complete_package(data, {}.__getitem__) == data
    assert split_package(io.BytesIO(data)).package == data


def test_known_textures_are_omitted_from_a_complete_package() -> None:
    known, sent = LAYOUT.textures
    complete = LAYOUT.complete({known.sha256})
    assert list(split_package(io.BytesIO(complete)).textures) == [sent]
    require_sound(io.BytesIO(complete))
    with pytest.raises(InvalidBundle, match=f"{known.sha256}.npy.zst is not in the package"):
        decode_scene(io.BytesIO(complete))


def _other_pixels(data: bytes) -> bytes:
    return encode_npy_zst(np.zeros((512, 512, 3), np.uint8))


@pytest.mark.parametrize("change", [lambda data: data[:-1], _other_pixels], ids=["cut", "other"])
def test_a_damaged_texture_is_refused(change: Callable[[bytes], bytes]) -> None:
    parts = members(LAYOUT.complete())
    name = next(iter(LAYOUT.textures)).file
    with pytest.raises(InvalidBundle, match=name):
        require_sound(packed(parts | {name: change(parts[name])}))


def test_a_texture_that_is_not_a_layer_is_refused_though_its_digest_is_right() -> None:
    scene = layout_scene("home_00001")
    made = encode_layout(replace(scene, textures=(scene.textures[0][:8, :8], scene.textures[1])))
    with pytest.raises(InvalidBundle, match=r"shape \(8, 8, 3\)"):
        require_sound(io.BytesIO(MadeLayout(made.data, made.textures).complete()))


@pytest.mark.parametrize("name", ["textures/../x.npy.zst", "textures/notes.txt", "more.npy.zst"])
def test_a_member_that_the_format_does_not_have_is_refused(name: str) -> None:
    with pytest.raises(InvalidBundle, match="members that format 4 does not have"):
        require_sound(packed(members(LAYOUT.package) | {name: b"x"}))


@pytest.mark.parametrize("sha256", ["../" + "a" * 61, "A" * 64, "a" * 63])
def test_a_name_that_is_not_a_digest_is_refused(sha256: str) -> None:
    with pytest.raises(ValueError, match="sha256"):
        TextureFile(sha256=sha256, size=1)


def test_a_texture_above_the_limit_is_refused() -> None:
    with pytest.raises(ValueError, match="size"):
        TextureFile(sha256="a" * 64, size=(1 << 20) + 1)


@pytest.mark.parametrize("steps", [[0, 2], [0, 0, 0], [1, 0], [0]], ids=["before", "too-many", "first", "unused"])
def test_place_steps_that_do_not_match_the_stored_positions_are_refused(steps: list[int]) -> None:
    with pytest.raises(InvalidBundle, match="place_steps"):
        join_positions(np.zeros((2, 3), np.float32), np.array(steps, np.uint32))


def test_positions_and_light_are_restored_bit_by_bit() -> None:
    rng = np.random.default_rng(1)
    positions = rng.normal(size=(40, 3)).astype(np.float32)[rng.integers(0, 40, 300)]
    positions[7, 0] = -0.0
    assert join_positions(*split_positions(positions)).tobytes() == positions.tobytes()
    empty = np.zeros((0, 3), np.float32)
    assert join_positions(*split_positions(empty)).shape == (0, 3)
    light = rng.integers(0, 256, (11, 6, 3)).astype(np.uint8)
    np.testing.assert_array_equal(join_light(split_light(light)), light)
    assert join_light(split_light(np.zeros((0, 0, 3), np.uint8))).shape == (0, 0, 3)


def test_textures_are_read_from_the_folder_beside_the_package(tmp_path: Path) -> None:
    path = LAYOUT.write(tmp_path / "home.scene.zip")
    assert_equal(read_scene(path), layout_scene("home_00001"))
    assert faulty_textures(path) == []
    first, second = (tmp_path / texture.file for texture in LAYOUT.textures)
    first.unlink()
    second.write_bytes(bytes(second.stat().st_size))
    assert faulty_textures(path) == list(LAYOUT.textures)
    assert read_geometry(path).info == read_info(path)


def test_a_missing_texture_is_named_with_its_package_and_the_remedy(tmp_path: Path) -> None:
    path = make_layout("home_00009", shades=(17,)).write(tmp_path / "home.scene.zip")
    (texture,) = read_info(path).textures
    (tmp_path / texture.file).unlink()
    with pytest.raises(InvalidBundle) as caught:
        read_scene(path)
    for part in (str(path), f"texture {tmp_path / texture.file} is missing", "copy the folder `textures`"):
        assert part in str(caught.value)


def test_a_copied_package_has_its_textures(tmp_path: Path) -> None:
    source = LAYOUT.write(tmp_path / "a/home.scene.zip")
    (tmp_path / "b").mkdir()
    copy_package(source, tmp_path / "b/copy.scene.zip")
    assert_equal(read_scene(tmp_path / "b/copy.scene.zip"), layout_scene("home_00001"))
