"""Converts a floor plan to the content of a scene, as the importer returns it for a file. Writes no files."""

from __future__ import annotations

import hashlib
import io
import math
from collections.abc import Iterable, Sequence
from functools import cache

import numpy as np
from PIL import Image

from factory.scenes.author.drawn import draw_pixels
from factory.scenes.author.geometry import merge
from factory.scenes.author.materials import PropPiece, SurfaceMaterial, linear_rgb
from factory.scenes.author.placement import FloorPlan, PropPlacement
from factory.scenes.importer import Extraction, Surface, TextureRecipe
from factory.scenes.importer.collect import Collector, Piece
from factory.scenes.importer.polygons import triangulate
from factory.scenes.limits import USUAL_LIMITS
from schemas.support.numpy_types import Floats

_WHITE = (1.0, 1.0, 1.0)


def content_of(plan: FloorPlan, name: str, made_from: str) -> Extraction:
    """Returns the content of a floor plan; the paths are those of the prims that `write_scene` writes.

    Args:
        plan: floor plan of the scene, metres.
        name: name of the scene.
        made_from: description of all inputs of the plan; the content records its digest.
    """
    scene = Collector(name, USUAL_LIMITS)
    for structure in plan.structures:
        _place(scene, f"/World/Building/{structure.name}", _pieces(structure.pieces), np.eye(4))
    known: dict[str, list[Piece]] = {}
    for placement in plan.placements:
        path = f"/World/Props/{placement.name}"
        scene.models.add(path)
        scene.components.add(path)
        if placement.model.name not in known:
            known[placement.model.name] = _pieces(placement.model.pieces)
        _place(scene, path, known[placement.model.name], _to_world(placement))
    names = sorted({part.surface.texture for part in scene.parts} - {""})
    images = {name: TextureRecipe(name) for name in names}
    return scene.extraction(1.0, {name: hashlib.sha256(made_from.encode()).hexdigest()}, images)


def by_material(pieces: Iterable[PropPiece]) -> dict[str, list[PropPiece]]:
    groups: dict[str, list[PropPiece]] = {}
    for piece in pieces:
        groups.setdefault(piece.material.name, []).append(piece)
    return groups


@cache
def encode_texture(name: str) -> bytes:
    """Returns a texture as PNG."""
    buffer = io.BytesIO()
    Image.fromarray(draw_pixels(TextureRecipe(name))).save(buffer, "PNG", compress_level=1)
    return buffer.getvalue()


def _place(scene: Collector, path: str, pieces: Sequence[Piece], to_world: Floats) -> None:
    for number, piece in enumerate(pieces):
        scene.place(f"{path}/Geo_{number}", [piece], to_world)


def _to_world(placement: PropPlacement) -> Floats:
    c, s = math.cos(placement.yaw), math.sin(placement.yaw)
    return np.array([[c, -s, 0, placement.x], [s, c, 0, placement.y], [0, 0, 1, placement.z], [0, 0, 0, 1]])


def _pieces(pieces: Sequence[PropPiece]) -> list[Piece]:
    """Returns one triangulated piece for each material."""
    chosen = []
    for group in by_material(pieces).values():
        material = group[0].material
        mesh = merge([piece.mesh for piece in group], material.tile_m)
        corners = triangulate(mesh.points, mesh.counts, mesh.indices).corners
        uvs = None if material.texture is None or mesh.st is None else mesh.st[corners]
        chosen.append(Piece(mesh.points[mesh.indices[corners]], uvs, None, _surface(material)))
    return chosen


def _surface(material: SurfaceMaterial) -> Surface:
    rgb, is_metal = linear_rgb(material.colour), material.metallic > 0.5
    if material.texture is not None:
        tint = _WHITE if material.tint is None else linear_rgb(material.tint)
        return Surface(
            colour=tint, texture=material.texture, emits=material.glow > 0, name=material.name, is_metal=is_metal
        )
    red, green, blue = (channel * material.glow for channel in rgb)
    emits = max(red, green, blue) > 0.05
    return Surface(colour=rgb, emits=emits, emission=(red, green, blue), name=material.name, is_metal=is_metal)
