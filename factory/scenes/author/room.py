"""Builds the parts of a building: walls with doors and skirting, floors, ceilings with lamps, floor markings.

Adds structures to a floor plan, in world metres. Does not place furniture, and does not choose the positions of rooms
or a ceiling.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from factory.scenes.author.geometry import AuthoredMesh, Vector, block, lathe, open_block, quad, tube, uncapped
from factory.scenes.author.materials import PropPiece, SurfaceMaterial, glowing, painted, textured, tinted, wood
from factory.scenes.author.placement import FloorPlan, Rectangle

_PLASTER = tinted("Plaster", "CeilingPlaster", colour="#eeece6", tile_m=1.0, roughness=0.9)
_BOARDS = tinted("Boards", "CeilingBoards", colour="#d9b98a", tile_m=1.2, roughness=0.6)
_BARE = tinted("Plaster", "CeilingBare", colour="#b9b8b3", tile_m=1.0, roughness=0.9)
_TILES = textured("CeilingTile", "#e6e5e0", 1.2, 0.9)
_ROOF = tinted("WallPanel", "RoofSheet", colour="#b4bac0", tile_m=4.0, roughness=0.8)
_DUCT = painted("LightGrey", 0.35, 1.0)
_GIRDER_PITCH_M = 5.0


def build_ceiling(plan: FloorPlan, area: Rectangle, style: str, top: float) -> None:
    """Adds a ceiling with lamps.

    Args:
        plan: receives the structures.
        area: floor below it, metres.
        style: plain, beams, boards, panels, tiles, ducts or girders.
        top: height of its lower side, metres.
    """
    if style == "tiles":
        ceiling(plan, area, top, _TILES)
        return
    if style == "girders":
        ceiling_slab(plan, area, top, _ROOF)
        high_bay_lamps(plan, area, top, _GIRDER_PITCH_M)
        return
    ceiling_slab(plan, area, top, {"boards": _BOARDS, "ducts": _BARE}.get(style, _PLASTER))
    if style == "beams":
        _beams(plan, area, top)
    if style == "ducts":
        _duct(plan, area, top)
    pitch = 2.4 if style == "panels" else 2.9
    columns, rows = max(1, round(area.width / pitch)), max(1, round(area.depth / pitch))
    pieces: list[PropPiece] = []
    for column in range(columns):
        for row in range(rows):
            x = area.x0 + (column + 0.5) * area.width / columns
            y = area.y0 + (row + 0.5) * area.depth / rows
            pieces += _panel_lamp(x, y, top) if style == "panels" else _round_lamp(x, y, top)
    plan.build("SM_CeilingLight", *pieces)


def _beams(plan: FloorPlan, area: Rectangle, top: float) -> None:
    count = max(1, round(area.depth / 1.1))
    rows = [area.y0 + (row + 0.5) * area.depth / count for row in range(count)]
    beams = [open_block((area.x0, y - 0.07, top - 0.14), (area.x1, y + 0.07, top), "SNB") for y in rows]
    plan.build("SM_Beam", *(PropPiece(wood("Walnut"), beam) for beam in beams))


def _duct(plan: FloorPlan, area: Rectangle, top: float) -> None:
    """Adds a round air duct along the longer side, a third of the way across, clear of the lamps."""
    z, (x, y) = top - 0.19, (area.x0 + 0.31 * area.width, area.y0 + 0.31 * area.depth)
    is_along_x = area.width >= area.depth
    ends = ((area.x0, y, z), (area.x1, y, z)) if is_along_x else ((x, area.y0, z), (x, area.y1, z))
    plan.build("SM_Duct", PropPiece(_DUCT, uncapped(tube(ends, 0.16, 10))))


def _panel_lamp(x: float, y: float, top: float) -> list[PropPiece]:
    z = top - 0.032
    glass = quad([(x - 0.55, y + 0.28, z), (x + 0.55, y + 0.28, z), (x + 0.55, y - 0.28, z), (x - 0.55, y - 0.28, z)])
    return [
        PropPiece(LAMP_RIM, block((x - 0.6, y - 0.32, top - 0.03), (x + 0.6, y + 0.32, top))),
        PropPiece(LAMP, glass),
    ]


def _round_lamp(x: float, y: float, top: float) -> list[PropPiece]:
    """Returns a pendant lamp: rose, cord and a flat glass drum, whose lower face lights the room."""
    rose = lathe([(0.05, top - 0.03), (0.06, top)], (x, y), 8)
    cord = lathe([(0.006, top - 0.24), (0.006, top - 0.03)], (x, y), 4)
    shade = lathe([(0.30, top - 0.34), (0.28, top - 0.24)], (x, y), 12)
    return [PropPiece(PLATE, rose), PropPiece(LAMP_RIM, cord), PropPiece(glowing("LampGlass", "#fff4de"), shade)]


WALL_THICKNESS_M = 0.12
DOOR_CLEARANCE_M = 0.9
"""Depth of the zone without furniture on both sides of a door, metres."""

SKIRTING = painted("Charcoal", 0.5)
DOOR_FRAME = textured("WoodOak", "#c39a66", 0.9)
LAMP = glowing("LampPanel", "#fffdf4")
LAMP_RIM = painted("LightGrey", 0.5)

PLATE = painted("White", 0.45)
SOCKET_PITCH_M = 2.8


class Trim(NamedTuple):
    """Trim of one face of a wall: skirting, sockets and switches, optionally a painted dado and a bumper rail."""

    rail: SurfaceMaterial | None = None
    """Material of the bumper rail at 0.80-0.95 m, or None."""
    dado: SurfaceMaterial | None = None
    """Material of the dado from the skirting to `dado_top_m`, 4 mm thick, or None."""
    dado_top_m: float = 0.80
    skirting: SurfaceMaterial = SKIRTING
    has_sockets: bool = True
    frame: SurfaceMaterial = DOOR_FRAME
    """Material of the door frames."""


PLAIN = Trim()
"""Trim with skirting and sockets only."""
Trims = tuple[Trim | None, Trim | None]
"""Trims of the faces towards lower and towards higher coordinates; None for a face that is not visible."""


class Doorway(NamedTuple):
    """Opening in a wall: centre along the wall (world coordinate), clear width and height, metres."""

    centre: float
    width: float
    height: float = 2.1


class _Strip(NamedTuple):
    """Converts (along, across, z) ranges to blocks of a wall along x or y.

    `side` is -1 for the face of the wall towards lower coordinates, and 1 for the opposite face.
    """

    is_along_x: bool
    at: float

    def box(self, along: tuple[float, float], across: tuple[float, float], z: tuple[float, float]) -> AuthoredMesh:
        """Returns a block with ranges along the wall, across it from its centre line, and in height, metres."""
        low, high = self._corners(along, across, z)
        return block(low, high)

    def leaf(self, along: tuple[float, float], side: float, z: tuple[float, float]) -> AuthoredMesh:
        """Returns the half of the wall on one side, without its inner face, which is hidden."""
        # the scenes have no hidden faces, because every triangle takes time in each frame
        return self._backless(along, side, (0.0, WALL_THICKNESS_M / 2), z)

    def applied(self, along: tuple[float, float], side: float, proud: float, z: tuple[float, float]) -> AuthoredMesh:
        """Returns a bar, `proud` metres thick, on a face of the wall; the bar has no back face."""
        return self._backless(along, side, (WALL_THICKNESS_M / 2, WALL_THICKNESS_M / 2 + proud), z)

    def _backless(
        self, along: tuple[float, float], side: float, out: tuple[float, float], z: tuple[float, float]
    ) -> AuthoredMesh:
        """Returns a block from `out[0]` to `out[1]` metres off the centre line, without the face towards this line."""
        near, far = sorted((side * out[0], side * out[1]))
        front = ("SN" if self.is_along_x else "WE")[side > 0]
        return open_block(*self._corners(along, (near, far), z), front + ("EWBT" if self.is_along_x else "SNBT"))

    def _corners(
        self, along: tuple[float, float], across: tuple[float, float], z: tuple[float, float]
    ) -> tuple[Vector, Vector]:
        a0, a1 = along
        c0, c1 = self.at + across[0], self.at + across[1]
        if self.is_along_x:
            return (a0, c0, z[0]), (a1, c1, z[1])
        return (c0, a0, z[0]), (c1, a1, z[1])

    def plate(self, along: tuple[float, float], side: float, proud: float, z: tuple[float, float]) -> AuthoredMesh:
        """Returns a rectangle `proud` metres in front of a face of the wall."""
        left, right = along if (side < 0) == self.is_along_x else along[::-1]
        c = self.at + side * (WALL_THICKNESS_M / 2 + proud)
        corners = [(left, z[0]), (right, z[0]), (right, z[1]), (left, z[1])]
        return quad([(a, c, height) if self.is_along_x else (c, a, height) for a, height in corners])

    def zone(self, along: tuple[float, float], across: tuple[float, float]) -> Rectangle:
        """Returns the floor rectangle with ranges along the wall and across it from its centre line, metres."""
        a0, a1 = along
        c0, c1 = self.at + across[0], self.at + across[1]
        return Rectangle(a0, c0, a1, c1) if self.is_along_x else Rectangle(c0, a0, c1, a1)


def wall(
    plan: FloorPlan,
    is_along_x: bool,
    at: float,
    span: tuple[float, float],
    faces: tuple[SurfaceMaterial, SurfaceMaterial],
    doors: Sequence[Doorway] = (),
    height: float = 2.8,
    trims: Trims = (PLAIN, PLAIN),
) -> None:
    """Builds a wall with door openings, lintels, frames and trim, and keeps the door zones clear.

    Args:
        plan: floor plan that receives the structures and the clear zones.
        is_along_x: whether the wall is parallel to x (else to y).
        at: position of the centre line on the other axis, metres.
        span: start and end along the wall, metres.
        faces: materials of the faces towards lower and towards higher coordinates.
        doors: openings without overlap.
        height: height of the wall, metres.
        trims: trims of both faces.
    """
    strip, half = _Strip(is_along_x, at), WALL_THICKNESS_M / 2
    pieces: list[PropPiece] = []
    start = span[0]
    for door in sorted(doors):
        left, right = door.centre - door.width / 2, door.centre + door.width / 2
        pieces += _solid(strip, (start, left), (0.0, height), faces, trims)
        pieces += _solid(strip, (left, right), (door.height, height), faces, (None, None))
        frame = next((trim.frame for trim in trims if trim is not None), DOOR_FRAME)
        pieces += _door_frame(strip, left, right=right, height=door.height, material=frame)
        pieces += _switches(strip, right, trims)
        zone = (left - 0.1, right + 0.1)
        plan.keep_clear(strip.zone(zone, (-half - DOOR_CLEARANCE_M, half + DOOR_CLEARANCE_M)))
        start = right
    pieces += _solid(strip, (start, span[1]), (0.0, height), faces, trims)
    plan.build("SM_Wall", *pieces)


def _solid(
    strip: _Strip,
    along: tuple[float, float],
    z: tuple[float, float],
    faces: tuple[SurfaceMaterial, SurfaceMaterial],
    trims: Trims,
) -> list[PropPiece]:
    """Returns one wall section without openings: two leaves of half thickness, with trim."""
    if along[1] - along[0] < 1e-3:
        return []
    pieces = [
        PropPiece(faces[0], strip.leaf(along, -1.0, z)),
        PropPiece(faces[1], strip.leaf(along, 1.0, z)),
    ]
    for trim, side in zip(trims, (-1.0, 1.0), strict=True):
        if trim is not None:
            pieces += _trim(strip, along, trim, side)
    return pieces


def _trim(strip: _Strip, along: tuple[float, float], trim: Trim, side: float) -> list[PropPiece]:
    """Returns skirting, dado, rail and sockets of one face of a wall."""
    start, end = along
    pieces = [PropPiece(trim.skirting, strip.applied(along, side, 0.012, (0.0, 0.09)))]
    if trim.dado is not None:
        pieces.append(PropPiece(trim.dado, strip.applied(along, side, 0.004, (0.09, trim.dado_top_m))))
    if trim.rail is not None and end - start > 0.3:
        pieces.append(PropPiece(trim.rail, strip.applied((start + 0.09, end - 0.09), side, 0.045, (0.80, 0.95))))
    count = round((end - start) / SOCKET_PITCH_M) if trim.has_sockets else 0
    for number in range(count):
        middle = start + (number + 0.5) * (end - start) / count
        pieces.append(PropPiece(PLATE, strip.plate((middle - 0.08, middle + 0.08), side, 0.005, (0.26, 0.34))))
        for shift in (-0.038, 0.038):
            hole = (middle + shift - 0.022, middle + shift + 0.022)
            pieces.append(PropPiece(LAMP_RIM, strip.plate(hole, side, 0.007, (0.278, 0.322))))
    return pieces


def _switches(strip: _Strip, right: float, trims: Trims) -> list[PropPiece]:
    """Returns a light switch beside the door on each visible face."""
    pieces: list[PropPiece] = []
    for trim, side in zip(trims, (-1.0, 1.0), strict=True):
        if trim is not None:
            a = right + 0.2
            pieces.append(PropPiece(PLATE, strip.plate((a - 0.04, a + 0.04), side, 0.005, (1.02, 1.10))))
            pieces.append(PropPiece(LAMP_RIM, strip.plate((a - 0.018, a + 0.018), side, 0.007, (1.03, 1.09))))
    return pieces


def _door_frame(strip: _Strip, left: float, right: float, height: float, material: SurfaceMaterial) -> list[PropPiece]:
    """Returns the architraves around an opening; they do not reduce its clear width."""
    half = WALL_THICKNESS_M / 2 + 0.02
    parts = [
        strip.box((left - 0.08, left + 0.002), (-half, half), (0.0, height + 0.08)),
        strip.box((right - 0.002, right + 0.08), (-half, half), (0.0, height + 0.08)),
        strip.box((left, right), (-half, half), (height - 0.002, height + 0.08)),
    ]
    return [PropPiece(material, part) for part in parts]


def floor(plan: FloorPlan, area: Rectangle, material: SurfaceMaterial) -> None:
    """Adds a floor slab whose top is at z = 0."""
    plan.build("SM_Floor", PropPiece(material, block((area.x0, area.y0, -0.05), (area.x1, area.y1, 0.0))))


def ceiling(
    plan: FloorPlan, area: Rectangle, height: float, material: SurfaceMaterial, lamp_pitch: float = 2.6
) -> None:
    """Adds a ceiling slab with a grid of lamp panels, 0.3 x 1.2 m."""
    ceiling_slab(plan, area, height, material)
    columns, rows = max(1, round(area.width / lamp_pitch)), max(1, round(area.depth / lamp_pitch))
    pieces: list[PropPiece] = []
    for column in range(columns):
        for row in range(rows):
            x = area.x0 + (column + 0.5) * area.width / columns
            y = area.y0 + (row + 0.5) * area.depth / rows
            pieces.append(PropPiece(LAMP_RIM, block((x - 0.64, y - 0.19, height - 0.03), (x + 0.64, y + 0.19, height))))
            pieces.append(PropPiece(LAMP, _hung((x - 0.6, y - 0.15), (x + 0.6, y + 0.15), height - 0.032)))
    plan.build("SM_Lamps", *pieces)
    _ceiling_fittings(plan, area, height)


def _ceiling_fittings(plan: FloorPlan, area: Rectangle, height: float) -> None:
    """Adds an air outlet with slats and a smoke detector, off the centre of the room."""
    x, y = area.x0 + 0.27 * area.width, area.y0 + 0.38 * area.depth
    slats = [_hung((x - 0.25, y - 0.24 + row * 0.08), (x + 0.25, y - 0.19 + row * 0.08), height - 0.014)
             for row in range(6)]  # fmt: skip
    detector = lathe([(0.04, height - 0.045), (0.055, height)], area.centre, 8)
    plan.build(
        "SM_Vent",
        PropPiece(PLATE, _hung((x - 0.3, y - 0.3), (x + 0.3, y + 0.3), height - 0.01)),
        *(PropPiece(SKIRTING, slat) for slat in slats),
        PropPiece(PLATE, detector),
    )


def _hung(low: tuple[float, float], high: tuple[float, float], z: float) -> AuthoredMesh:
    """Returns a horizontal rectangle that is visible from below."""
    return quad([(low[0], high[1], z), (high[0], high[1], z), (high[0], low[1], z), (low[0], low[1], z)])


def ceiling_slab(plan: FloorPlan, area: Rectangle, height: float, material: SurfaceMaterial) -> None:
    """Adds a ceiling slab without lamps."""
    plan.build("SM_Ceiling", PropPiece(material, block((area.x0, area.y0, height), (area.x1, area.y1, height + 0.05))))


def high_bay_lamps(plan: FloorPlan, area: Rectangle, height: float, pitch: float) -> None:
    """Adds roof girders along y with bell lamps below them."""
    columns, rows = max(1, round(area.width / pitch)), max(1, round(area.depth / pitch))
    steel, pieces = painted("Steel", 0.4, 1.0), []
    for column in range(columns):
        x = area.x0 + (column + 0.5) * area.width / columns
        pieces.append(PropPiece(steel, block((x - 0.08, area.y0, height - 0.35), (x + 0.08, area.y1, height - 0.05))))
        for row in range(rows):
            y = area.y0 + (row + 0.5) * area.depth / rows
            bell = lathe([(0.28, height - 0.80), (0.10, height - 0.50), (0.05, height - 0.35)], (x, y), 10)
            pieces.append(PropPiece(steel, uncapped(bell)))
            pieces.append(PropPiece(LAMP, lathe([(0.26, height - 0.82), (0.28, height - 0.80)], (x, y), 10)))
    plan.build("SM_Lamps", *pieces)


def marking(plan: FloorPlan, area: Rectangle, material: SurfaceMaterial) -> None:
    """Adds a flat floor marking 2 mm above the floor, so it is not an obstacle. Earlier markings stay visible."""
    parts = [area]
    for other in plan.covered:
        parts = [rest for part in parts for rest in part.without(other)]
    plan.covered.append(area)
    if parts:
        strips = (open_block((part.x0, part.y0, 0.0), (part.x1, part.y1, 0.002), "T") for part in parts)
        plan.build("SM_Marking", *(PropPiece(material, strip) for strip in strips))
