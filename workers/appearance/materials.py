"""Draws materials for the surfaces of a scene, and applies them. Pure functions.

Objects keep the name of their colour, so instructions stay true; walls, floors and ceilings change freely. If objects
that an instruction names kept their paint instead, targets would never vary.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from schemas.appearance import MaterialRanges, SurfaceChange
from schemas.appearance.colour_names import dominant_name, linear_of, name_indices, srgb_of
from schemas.scene import TEXTURE_SIZE_PX, CompiledScene
from schemas.support.numpy_types import Floats, Ints
from schemas.terms import COLOUR_NAMES
from workers.appearance.factor_stream import FactorStream
from workers.appearance.palettes import CEILINGS, FLOORS, WALLS, Material, paints_named
from workers.appearance.surfaces import SurfaceSlot, find_slots, hex_of, rgb_of

_SAMPLES = 300
"""Number of points on an object from which the name of its colour is determined."""
_DOWN = -0.7
_MAIN_SHARE = 0.25
"""Smallest area of a slot that gets a new colour, as a share of the largest slot with the same texture; smaller slots
are trims. A texture is not replaced if its largest slot covers less than `_MAIN_SHARE` / 4 of the total area of the
walls or of the floors."""
_TINTS = (0.8, 1.0)
"""Range of the factor that darkens the textures of objects."""


@dataclass(frozen=True)
class SceneSurfaces:
    """Slots of a scene, and points on the objects whose colours instructions may name."""

    slots: tuple[SurfaceSlot, ...]
    """Surfaces that change together, in a fixed order."""
    of_vertex: Ints
    """(V,) slot of each vertex, or -1."""
    area: Floats
    """(S,) area of each slot, square metres."""
    owner: Ints
    """(N,) instance of each point."""
    slot: Ints
    """(N,) slot of each point, or -1."""
    plain: Floats
    """(N, 3) linear colour of the texture at each point, white without a texture; `base` multiplies it."""
    base: Floats
    """(N, 3) linear colour of the vertex of each point."""

    @classmethod
    def of(cls, scene: CompiledScene) -> Self:
        """Finds the slots of a scene, and points on its objects."""
        slots, of_vertex = find_slots(scene)
        triangles = scene.positions.reshape(-1, 3, 3).astype(np.float64)
        cross = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
        areas = np.sqrt((cross**2).sum(axis=1)) / 2
        triangle_colours = of_vertex[::3]
        area = np.bincount(triangle_colours[triangle_colours >= 0], areas[triangle_colours >= 0], len(slots)).astype(
            np.float64
        )
        owner, triangle, weights = _points(scene, areas, cross)
        plain = _texels(scene, triangle, weights)
        base = linear_of(scene.colours[3 * triangle] / 255)
        return cls(tuple(slots), of_vertex, area, owner, triangle_colours[triangle], plain, base)

    def names(self, changes: tuple[SurfaceChange, ...] = ()) -> dict[int, str]:
        """Returns the colour name of each object of a category, by instance id, after some changes of materials."""
        colour = self.base.copy()
        numbers = {slot: number for number, slot in enumerate(self.slots)}
        for change in changes:
            number = numbers.get(SurfaceSlot(change.surface, change.layer, change.colour), -1)
            if number >= 0:
                colour[self.slot == number] = linear_of(np.array(rgb_of(change.to_colour)) / 255)
        shown = srgb_of(colour * self.plain)
        ends = np.flatnonzero(np.diff(self.owner)) + 1
        rows = np.split(np.arange(len(self.owner)), ends) if len(self.owner) else []
        return {int(self.owner[part[0]]): dominant_name(shown[part]) for part in rows}


def draw_materials(
    ranges: MaterialRanges, surfaces: FactorStream, furniture: FactorStream, scene: SceneSurfaces
) -> tuple[SurfaceChange, ...]:
    """Returns the changed materials of an episode.

    Args:
        ranges: sets of materials.
        surfaces: random numbers for walls, floors and ceilings.
        furniture: random numbers for other objects.
        scene: surfaces of the scene.
    """
    changes: list[SurfaceChange] = []
    for kind, names, table in (("wall", ranges.walls, WALLS), ("floor", ranges.floors, FLOORS)):
        if names:
            changes += _surface_changes(kind, [table[name] for name in names], surfaces, scene)
    if ranges.ceilings:
        factor = np.array(rgb_of(surfaces.choose(CEILINGS))) / 255
        changes += [_tinted(slot, factor) for slot in scene.slots if slot.surface == "ceiling"]
    if ranges.furniture:
        changes += _furniture(furniture, scene)
    return tuple(change for change in changes if change.to_colour != change.colour or change.texture)


def _surface_changes(
    kind: str, materials: list[Material], stream: FactorStream, scene: SceneSurfaces
) -> list[SurfaceChange]:
    """Returns changes of walls or floors.

    All surfaces with the same texture get the same material; small surfaces keep their colour.
    """
    changes = []
    slots_of_kind = [number for number, slot in enumerate(scene.slots) if slot.surface == kind]
    total = sum(scene.area[number] for number in slots_of_kind)
    for layer in sorted({scene.slots[number].layer for number in slots_of_kind}):
        group = [number for number in slots_of_kind if scene.slots[number].layer == layer]
        material = stream.choose(materials)
        largest = max(scene.area[number] for number in group)
        if largest < _MAIN_SHARE * total / 4:
            continue
        for number in group:
            slot, colour = scene.slots[number], stream.choose(material.colours)
            kept = colour if scene.area[number] >= _MAIN_SHARE * largest else slot.colour
            changes.append(_change(slot, kept, material))
    return changes


def _furniture(stream: FactorStream, scene: SceneSurfaces) -> list[SurfaceChange]:
    """Returns changes of objects after which each object with a category has the same colour name as before."""
    drawn = {slot: _repainted(slot, stream) for slot in scene.slots if slot.surface == "object"}
    before = scene.names()
    while True:
        after = scene.names(tuple(drawn.values()))
        wrong = {number for number, name in after.items() if name != before[number]}
        spoilt = {int(number) for number in np.unique(scene.slot[np.isin(scene.owner, list(wrong))])}
        again = [scene.slots[number] for number in spoilt if number >= 0 and scene.slots[number] in drawn]
        if not again:
            return list(drawn.values())
        for slot in again:
            del drawn[slot]


def _repainted(slot: SurfaceSlot, stream: FactorStream) -> SurfaceChange:
    """Returns a change to another colour with the same name; a slot with a texture gets a darker tint instead."""
    pick, tint = stream.share(), stream.between(_TINTS)
    if slot.layer >= 0:
        return _tinted(slot, np.full(3, tint))
    name = int(name_indices(np.array(rgb_of(slot.colour)) / 255))
    paints = paints_named(name) if name < len(COLOUR_NAMES) else ()
    return _change(slot, paints[int(pick * len(paints))] if paints else slot.colour)


def _tinted(slot: SurfaceSlot, factor: Floats) -> SurfaceChange:
    return _change(slot, hex_of(np.array(rgb_of(slot.colour)) * factor))


def _change(slot: SurfaceSlot, colour: str, material: Material | None = None) -> SurfaceChange:
    new = {} if material is None else {"texture": material.pattern, "tile_m": material.tile_m}
    return SurfaceChange.model_validate(
        {"surface": slot.surface, "layer": slot.layer, "colour": slot.colour, "to_colour": colour, **new}
    )


def _points(scene: CompiledScene, areas: Floats, cross: Floats) -> tuple[Ints, Ints, Floats]:
    """Returns points spread evenly over the area of each object with a category.

    Each point is an instance, a triangle and barycentric weights (N, 3).

    Faces that face down are omitted, as by the scene compiler when it names colours.
    """
    named = {item.id for item in scene.info.instances if item.category}
    of_triangle = np.zeros(len(areas), np.int64)
    for first, count, number in zip(scene.part_first, scene.part_count, scene.part_instance, strict=True):
        of_triangle[first // 3 : (first + count) // 3] = number
    shown = np.isin(of_triangle, sorted(named)) & (areas > 0) & (cross[:, 2] > _DOWN * 2 * areas)
    rows = np.flatnonzero(shown)
    rows = rows[np.argsort(of_triangle[rows], kind="stable")]
    owner, triangle = [], []
    for part in np.split(rows, np.flatnonzero(np.diff(of_triangle[rows])) + 1):
        if len(part):
            ends = np.cumsum(areas[part])
            spots = (np.arange(_SAMPLES) + 0.5) / _SAMPLES * ends[-1]
            triangle.append(part[np.minimum(np.searchsorted(ends, spots), len(part) - 1)])
            owner.append(np.full(_SAMPLES, of_triangle[part[0]]))
    if not triangle:
        return np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((0, 3))
    steps = np.arange(len(triangle) * _SAMPLES)
    along, across = (steps * 0.7548776662466927) % 1.0, (steps * 0.5698402909980532) % 1.0
    folded = along + across > 1
    along, across = np.where(folded, 1 - along, along), np.where(folded, 1 - across, across)
    weights = np.stack((1 - along - across, along, across), axis=1)
    return np.concatenate(owner), np.concatenate(triangle).astype(np.int64), weights


def _texels(scene: CompiledScene, triangle: Ints, weights: Floats) -> Floats:
    """Returns the linear colours (N, 3) of the texture at points of triangles; white without one."""
    layers = np.repeat(scene.part_texture, scene.part_count // 3).astype(np.int64)[triangle]
    colours = np.ones((len(triangle), 3))
    rows = np.flatnonzero(layers >= 0)
    corners = scene.uvs.reshape(-1, 3, 2)[triangle[rows]].astype(np.float64)
    uv = (corners * weights[rows][..., None]).sum(axis=1) % 1.0
    side = TEXTURE_SIZE_PX
    down, right = (np.minimum((part * side).astype(np.int64), side - 1) for part in (1 - uv[:, 1], uv[:, 0]))
    for layer in np.unique(layers[rows]):
        is_layer = layers[rows] == layer
        colours[rows[is_layer]] = linear_of(scene.textures[layer][down[is_layer], right[is_layer]] / 255)
    return colours


def planar_uvs(positions: NDArray[np.float32], tile_m: float) -> NDArray[np.float32]:
    """Returns texture coordinates (V, 2) of triangles: world positions along the two axes that they face least.

    Args:
        positions: (V, 3) corners, three for each triangle, metres.
        tile_m: length of one repeat, metres.
    """
    corners = positions.reshape(-1, 3, 3).astype(np.float64)
    normals = np.abs(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))
    axes = np.array(((1, 2), (0, 2), (0, 1)))[normals.argmax(axis=1)]
    return np.asarray(np.take_along_axis(corners, axes[:, None], axis=2).reshape(-1, 2) / tile_m, np.float32)
