"""Builds the vertex arrays of the renderer: unwelded vertices, sorted into runs of one instance and one texture.

Pure functions. Bakes the light map. Does not assign instance ids.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from factory.scenes.compile.surfaces import corner_colours, glow_brightness, glows_by_name, reflectance, texture_layer
from factory.scenes.compile.textures import TextureBook
from factory.scenes.importer import Part
from factory.scenes.light import USUAL_DETAIL, LightDetail, LightMap, TooManyPieces, bake_light


@dataclass(frozen=True)
class Geometry:
    """Render arrays of a compiled scene; fields as in `schemas.scene.CompiledScene`."""

    positions: NDArray[np.float32]
    uvs: NDArray[np.float32]
    colours: NDArray[np.uint8]
    light_uvs: NDArray[np.float32]
    light_map: NDArray[np.uint8]
    part_first: NDArray[np.int32]
    part_count: NDArray[np.int32]
    part_instance: NDArray[np.uint16]
    part_texture: NDArray[np.int16]


def lay_out_geometry(
    parts: Sequence[Part],
    owners: Sequence[str],
    ids: Mapping[str, int],
    book: TextureBook,
    floor_m: float,
    notes: list[str],
    detail: LightDetail = USUAL_DETAIL,
) -> Geometry:
    """Groups parts by instance and texture, and bakes their light map.

    Args:
        parts: visible parts.
        owners: path of the object of each part.
        ids: instance id of each object.
        book: textures of the scene.
        floor_m: height of the floor, metres.
        notes: list that receives a note if the light cannot be baked.
        detail: resolution of the light map, and number of rays.
    """
    keys = [(ids[owner], texture_layer(part, book)) for part, owner in zip(parts, owners, strict=True)]
    order = sorted(range(len(parts)), key=lambda row: (keys[row], parts[row].path))
    runs = [(key, sum(3 * len(parts[row].triangles) for row in rows)) for key, rows in groupby(order, keys.__getitem__)]
    counts = np.array([count for _, count in runs], np.int32)
    triangles = np.concatenate([parts[row].triangles for row in order])
    groups = np.repeat(np.arange(len(counts)), counts // 3)
    ordered = [parts[row] for row in order]
    grey = np.concatenate([reflectance(part, book) for part in ordered])
    light = _lit(triangles, groups, _brightness(ordered, book), floor_m, grey, notes, detail)
    return Geometry(
        positions=triangles.reshape(-1, 3).astype(np.float32),
        uvs=np.concatenate([_uvs(parts[row], keys[row][1]) for row in order]).astype(np.float32),
        colours=np.concatenate([corner_colours(parts[row], book).reshape(-1, 3) for row in order]),
        light_uvs=light.uvs.reshape(-1, 2),
        light_map=light.picture,
        part_first=(np.cumsum(counts) - counts).astype(np.int32),
        part_count=counts,
        part_instance=np.array([key[0] for key, _ in runs], np.uint16),
        part_texture=np.array([key[1] for key, _ in runs], np.int16),
    )


def _lit(
    triangles: NDArray[np.float64],
    groups: NDArray[np.int64],
    brightness: NDArray[np.float64],
    floor_m: float,
    grey: NDArray[np.float64],
    notes: list[str],
    detail: LightDetail,
) -> LightMap:
    """Bakes the light map; with too many charts, returns an empty map and adds a note."""
    try:
        return bake_light(triangles, groups, brightness=brightness, floor_m=floor_m, reflectance=grey, detail=detail)
    except TooManyPieces as error:
        notes.append(f"shown without baked light: {error}; decimate the densest meshes to have it")
        return LightMap(np.zeros((0, 3, 2), np.float32), np.zeros((0, 0, 3), np.uint8))


def _brightness(parts: Sequence[Part], book: TextureBook) -> NDArray[np.float64]:
    """Returns the emitted luminance of each triangle: as authored, or by prim name if the scene authors no emission."""
    is_authored = any(part.surface.emits for part in parts)
    glows = [part.surface.emits if is_authored else glows_by_name(part.path) for part in parts]
    values = [glow_brightness(part, book) if glow else 0.0 for part, glow in zip(parts, glows, strict=True)]
    return np.repeat(values, [len(part.triangles) for part in parts])


def _uvs(part: Part, layer: int) -> NDArray[np.float64]:
    """Returns texture coordinates (3 T, 2).

    Those of each triangle are shifted by whole repeats of the texture to values near zero, which float32 stores more
    exactly.
    """
    if layer < 0 or part.uvs is None:
        return np.zeros((3 * len(part.triangles), 2))
    finite = np.nan_to_num(part.uvs, posinf=0.0, neginf=0.0)
    return np.asarray((finite - np.floor(finite.min(axis=1, keepdims=True))).reshape(-1, 2))
