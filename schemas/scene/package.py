"""Writes and reads the packages of compiled scenes, in open binary files. Opens no path.

A package of format 3 contains its textures. One of format 4 lists their files, which the caller provides, and stores
vertex positions and light maps losslessly in arrays that compress better; a complete package contains the textures,
too (`schemas.scene.complete`). A package of format 5 is one of format 3 with masks of textures that cut holes.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from schemas.encoding.arrays import ArraySpec
from schemas.encoding.container import ContainerLimits, ContainerReader, ContainerWriter
from schemas.encoding.ndarray import compress, decode_npy_zst, decompress, encode_npy_zst
from schemas.errors import InvalidBundle
from schemas.scene.compiled import (
    MASK_LAYERS_SPEC,
    MASKS_SPEC,
    SCENE_ARRAYS,
    TEXTURES_SPEC,
    CompiledScene,
    Layer,
    contradictions,
)
from schemas.scene.info import CUTOUT_FORMAT, LAYOUT_FORMAT, MAX_TEXTURES, SCENE_FORMAT, SceneInfo, TextureFile
from schemas.scene.textures import ReadTexture, encode_texture, load_texture

PLACES = ArraySpec("places", (None, 3), dtype=np.float32, unit="m", low=-1e4, high=1e4)
"""(U, 3) distinct vertex positions in the order of their first use, metres."""
PLACE_STEPS = ArraySpec("place_steps", (None,), np.uint32, "1")
"""(V,) for each vertex, the number of distinct places before it minus the index of its place; 0 for a new place."""
LIGHT_STEPS = ArraySpec("light_steps", (3, None, None), np.uint8, "1")
"""(3, H, W) green, red - green and blue - green of the light map; each as the difference to the texel on the left."""


def split_positions(positions: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.uint32]]:
    """Returns `PLACES` and `PLACE_STEPS` of vertex positions (V, 3)."""
    rows = np.ascontiguousarray(positions).view(np.dtype((np.void, 12))).reshape(-1)
    _, firsts, places = np.unique(rows, return_index=True, return_inverse=True)
    order = np.argsort(firsts)
    rank = np.empty(len(order), np.int64)
    rank[order] = np.arange(len(order))
    place = rank[places]
    used = np.concatenate(([0], np.maximum.accumulate(place)[:-1] + 1)) if len(place) else place
    return positions[firsts[order]], (used - place).astype(np.uint32)


def join_positions(places: NDArray[np.float32], steps: NDArray[np.uint32]) -> NDArray[np.float32]:
    """Returns the vertex positions (V, 3) of `PLACES` and `PLACE_STEPS`.

    Raises:
        InvalidBundle: a step refers to a place that does not exist, or a place is not used.
    """
    is_first = steps == 0
    used = np.cumsum(is_first)
    rows = used - is_first - steps.astype(np.int64)
    if rows.min(initial=0) < 0 or np.count_nonzero(is_first) != len(places):
        raise InvalidBundle("scene refused", ["place_steps does not match the places in the package"])
    return np.asarray(places[rows], np.float32)


def split_light(light_map: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Returns `LIGHT_STEPS` of a light map (H, W, 3); all differences are modulo 256."""
    red, green, blue = (light_map[..., channel] for channel in range(3))
    planes = np.stack((green, red - green, blue - green))
    planes[:, :, 1:] -= planes[:, :, :-1].copy()
    return planes


def join_light(steps: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Returns the light map (H, W, 3) of `LIGHT_STEPS`."""
    green, red, blue = np.cumsum(steps, axis=2, dtype=np.uint8)
    return np.stack((red + green, green, blue + green), axis=2)


MAX_SCENE_BYTES = 512 << 20
"""Largest size of a package and of each of its members, bytes."""
PACKAGE_LIMITS = ContainerLimits(members=64 + MAX_TEXTURES, member_bytes=MAX_SCENE_BYTES)
"""Limits of a complete package."""
_READABLE = (2, SCENE_FORMAT, LAYOUT_FORMAT, CUTOUT_FORMAT)
_INFO, _SMALL_INFO = "scene.json", "scene.json.zst"
_MAX_INFO_BYTES = 256 << 20
_SMALLER: dict[str, tuple[Callable[..., NDArray[Any]], tuple[ArraySpec, ...]]] = {
    "positions": (join_positions, (PLACES, PLACE_STEPS)),
    "light_map": (join_light, (LIGHT_STEPS,)),
}
"""Arrays that format 4 stores in a smaller form, by name: the function that restores the array, and the specs of the
arrays that are stored instead."""
_LAYOUT_SPECS = [
    spec for name, own in SCENE_ARRAYS.items() for spec in (_SMALLER[name][1] if name in _SMALLER else (own,))
]
_LAYOUT_MEMBERS = {_SMALL_INFO, *(f"{spec.name}.npy.zst" for spec in _LAYOUT_SPECS)}


class LayoutPackage(NamedTuple):
    """Package of format 4 and the files of its textures."""

    data: bytes
    """Content of the package."""
    textures: dict[TextureFile, bytes]
    """Content of the files of its textures."""


def encode_scene(scene: CompiledScene, level: int = 9) -> bytes:
    """Returns the package of a scene with its textures; equal scenes give equal bytes with the same compressor.

    Args:
        scene: scene to encode, with the pixels of its textures.
        level: compression level of zstandard; level 1 takes a sixth of the time, for a package that is not stored.
    """
    info = scene.info
    if info.format == LAYOUT_FORMAT:
        info = info.model_copy(update={"format": SCENE_FORMAT, "textures": ()})
    if scene.masks:
        info = info.model_copy(update={"format": CUTOUT_FORMAT})
    arrays = {name: getattr(scene, name) for name in SCENE_ARRAYS} | {"textures": _stacked(scene)}
    order = [field.name for field in fields(scene) if field.name in arrays]
    members = {name: arrays[name] for name in order} | _masks_of(scene)
    return _pack(_INFO, _info_json(info), members, level)


def encode_layout(scene: CompiledScene, level: int = 9) -> LayoutPackage:
    """Returns the package of a scene without its textures, which it lists by the SHA-256 of their files.

    Args:
        scene: scene to encode, with the pixels of its textures.
        level: compression level of zstandard for the package.
    """
    encoded = [encode_texture(layer) for layer in scene.textures]
    files = tuple(file for file, _ in encoded)
    if scene.masks:
        raise ValueError(f"scene {scene.info.name} has masks, which a package of format {LAYOUT_FORMAT} cannot store")
    info = SceneInfo.model_validate(dict(scene.info) | {"format": LAYOUT_FORMAT, "textures": files})
    places, steps = split_positions(scene.positions)
    smaller = {"places": places, "place_steps": steps, "light_steps": split_light(scene.light_map)}
    arrays = {spec.name: smaller.get(spec.name, vars(scene).get(spec.name)) for spec in _LAYOUT_SPECS}
    return LayoutPackage(_pack(_SMALL_INFO, compress(_info_json(info), level), arrays, level), dict(encoded))


def decode_scene(file: BinaryIO, read_texture: ReadTexture | None = None) -> CompiledScene:
    """Decodes a package from a seekable file, and enforces the limit of every size.

    Args:
        file: package of any format, complete or not.
        read_texture: function that returns the files of textures that the package lists but does not contain.

    Raises:
        InvalidBundle: the package or a texture is damaged, missing or inconsistent, or has a different format version.
    """
    reader = ContainerReader(file, PACKAGE_LIMITS)
    return _decode(reader, lambda info: _layers(reader, info, read_texture))


def decode_geometry(file: BinaryIO) -> CompiledScene:
    """Decodes a package without the pixels of its textures: `textures` is empty.

    Raises:
        InvalidBundle: the package is damaged or inconsistent, or has a different format version.
    """
    return _decode(ContainerReader(file, PACKAGE_LIMITS), lambda _: ())


def read_scene_info(file: BinaryIO) -> SceneInfo:
    """Reads the metadata of a package, without its arrays.

    Raises:
        InvalidBundle: the package is damaged or has a different format version.
    """
    return _read_info(ContainerReader(file, PACKAGE_LIMITS))


def read_survey(file: BinaryIO) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """Reads `spawns` and `spawn_sees` of a package, without its other arrays.

    Raises:
        InvalidBundle: the package is damaged or has a different format version.
    """
    reader = ContainerReader(file, PACKAGE_LIMITS)
    spawns, sees = (_read_array(reader, SCENE_ARRAYS[name]) for name in ("spawns", "spawn_sees"))
    return spawns.astype(np.float32), sees.astype(np.uint8)


def _info_json(info: SceneInfo) -> bytes:
    # unused fields are omitted, so a scene without them has the same package as with older versions
    unused = {name for name in ("sky", "textures") if not getattr(info, name)}
    return info.model_dump_json(indent=1, exclude=unused).encode()


def _masks_of(scene: CompiledScene) -> dict[str, NDArray[Any]]:
    """Returns the members of format 5; empty without masks."""
    if not scene.masks:
        return {}
    layers = sorted(scene.masks)
    masks = np.stack([scene.masks[layer] for layer in layers])
    return {MASK_LAYERS_SPEC.name: np.array(layers, np.int16), MASKS_SPEC.name: masks}


def _read_masks(reader: ContainerReader) -> dict[int, NDArray[np.uint8]]:
    layers, masks = (_read_array(reader, spec) for spec in (MASK_LAYERS_SPEC, MASKS_SPEC))
    if len(layers) != len(masks) or len(set(layers.tolist())) != len(layers):
        raise InvalidBundle("scene refused", [f"{len(masks)} masks for the texture layers {layers.tolist()[:5]}"])
    return dict(zip(layers.tolist(), masks, strict=True))


def _stacked(scene: CompiledScene) -> NDArray[np.uint8]:
    if len(scene.textures) != scene.info.texture_count:
        raise ValueError(f"scene {scene.info.name} was read without the pixels of its textures")
    return np.stack(scene.textures) if scene.textures else np.zeros((0, *TEXTURES_SPEC.shape[1:]), np.uint8)  # type: ignore[arg-type]


def _pack(info_name: str, info: bytes, arrays: Mapping[str, Any], level: int) -> bytes:
    buffer = io.BytesIO()
    with ContainerWriter(buffer) as out:
        out.add(info_name, info)
        for name, array in arrays.items():
            out.add(f"{name}.npy.zst", encode_npy_zst(array, level=level))
    return buffer.getvalue()


def _decode(reader: ContainerReader, layers: Callable[[SceneInfo], tuple[Layer, ...]]) -> CompiledScene:
    info = _read_info(reader)
    if info.format == LAYOUT_FORMAT:
        stray = set(reader.names) - _LAYOUT_MEMBERS - {texture.file for texture in info.textures}
        if stray:
            raise InvalidBundle("scene refused", [f"members that format 4 does not have: {sorted(stray)[:5]}"])
    textures = layers(info)
    masks = _read_masks(reader) if info.format == CUTOUT_FORMAT and textures else {}
    scene = CompiledScene(info=info, **dict(_arrays(reader, info)), textures=textures, masks=masks)
    findings = contradictions(scene)
    if findings:
        raise InvalidBundle("scene refused", findings)
    return scene


def _arrays(reader: ContainerReader, info: SceneInfo) -> Iterator[tuple[str, Any]]:
    for name, spec in SCENE_ARRAYS.items():
        if info.format == LAYOUT_FORMAT and name in _SMALLER:
            join, specs = _SMALLER[name]
            yield name, join(*(_read_array(reader, each) for each in specs))
        else:
            yield name, _read_array(reader, spec)


def _layers(reader: ContainerReader, info: SceneInfo, read_texture: ReadTexture | None) -> tuple[Layer, ...]:
    if info.format != LAYOUT_FORMAT:
        return tuple(_read_array(reader, TEXTURES_SPEC))

    def read(texture: TextureFile) -> bytes:
        if texture.file in reader.names:
            return reader.read(texture.file)
        if read_texture is None:
            raise InvalidBundle("texture missing", [f"{texture.file} is not in the package"])
        return read_texture(texture)

    return tuple(load_texture(texture, read) for texture in info.textures)


def _read_info(reader: ContainerReader) -> SceneInfo:
    is_small = _SMALL_INFO in reader.names
    data = reader.read(_SMALL_INFO if is_small else _INFO)
    try:
        info = SceneInfo.model_validate_json(decompress(_SMALL_INFO, data, _MAX_INFO_BYTES) if is_small else data)
    except ValidationError as error:
        raise InvalidBundle("scene refused", [f"{_INFO}: {item['msg']}" for item in error.errors()]) from error
    if info.format not in _READABLE or is_small != (info.format == LAYOUT_FORMAT):
        remedy = "create it again with `factory scene build` or `factory scene import`"
        problem = f"scene format {info.format}, this software reads {', '.join(map(str, _READABLE))}; {remedy}"
        raise InvalidBundle("scene refused", [problem])
    return info


def _read_array(reader: ContainerReader, spec: ArraySpec) -> NDArray[Any]:
    data = reader.read(f"{spec.name}.npy.zst")
    array = decode_npy_zst(spec.name, data, dtype=spec.dtype, shape=spec.shape, max_bytes=MAX_SCENE_BYTES)
    findings = spec.violations(array)
    if findings:
        raise InvalidBundle("scene refused", findings)
    return array
