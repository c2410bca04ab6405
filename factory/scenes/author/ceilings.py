"""Builds ceilings with lamps, in seven styles: plain, beams, boards, panels, tiles, ducts and girders.

Adds structures to a floor plan, in world metres. Does not choose a ceiling.
"""

from __future__ import annotations

from factory.scenes.author.geometry import block, lathe, open_block, quad, tube, uncapped
from factory.scenes.author.materials import PropPiece, glowing, painted, textured, tinted, wood
from factory.scenes.author.placement import FloorPlan, Rectangle
from factory.scenes.author.room import LAMP, LAMP_RIM, PLATE, ceiling, ceiling_slab, high_bay_lamps

_PLASTER = tinted("Plaster", "CeilingPlaster", "#eeece6", 1.0, 0.9)
_BOARDS = tinted("Boards", "CeilingBoards", "#d9b98a", 1.2, 0.6)
_BARE = tinted("Plaster", "CeilingBare", "#b9b8b3", 1.0, 0.9)
_TILES = textured("CeilingTile", "#e6e5e0", 1.2, 0.9)
_ROOF = tinted("WallPanel", "RoofSheet", "#b4bac0", 4.0, 0.8)
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
