"""Writes small USD stages as text, in any unit and with y or z up, for tests of the importer.

All arguments are in world metres with z up. Uses the standard library only.
"""

from __future__ import annotations

from pathlib import Path

Vector3 = tuple[float, float, float]


class StageText:
    """Writes prims in the units and axes of one stage."""

    def __init__(self, metres_per_unit: float = 1.0, up: str = "Z") -> None:
        self.metres_per_unit = metres_per_unit
        self.up = up

    def vector(self, metres: Vector3, is_size: bool = False) -> str:
        x, y, z = (value / self.metres_per_unit for value in metres)
        if self.up == "Y":
            x, y, z = (x, z, y) if is_size else (x, z, -y)
        return f"({x:.9g}, {y:.9g}, {z:.9g})"

    def box(self, name: str, low: Vector3, high: Vector3, colour: Vector3 = (0.5, 0.5, 0.5), more: str = "") -> str:
        """Returns a Cube gprim that extends from `low` to `high`."""
        middle = tuple((a + b) / 2 for a, b in zip(low, high, strict=True))
        size = tuple(b - a for a, b in zip(low, high, strict=True))
        return f"""
    def Cube "{name}" {{
        double size = 1
        color3f[] primvars:displayColor = [{colour}]
        double3 xformOp:translate = {self.vector(middle)}
        double3 xformOp:scale = {self.vector(size, is_size=True)}
        uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:scale"]
        {more}
    }}
"""

    def group(self, name: str, body: str, at: Vector3 | None = None, head: str = "", kind: str = "Xform") -> str:
        """Returns an Xform at `at` with the metadata `head` and the child prims `body`."""
        place = ""
        if at is not None:
            place = f"double3 xformOp:translate = {self.vector(at)}\n"
            place += 'uniform token[] xformOpOrder = ["xformOp:translate"]'
        return f'\ndef {kind} "{name}" ({head}) {{\n{place}\n{body}\n}}\n'

    def write(self, path: Path, body: str, units: str | None = None) -> Path:
        """Writes a stage whose default prim `World` contains `body`."""
        metres = f"metersPerUnit = {self.metres_per_unit}" if units is None else units
        text = f'#usda 1.0\n(\ndefaultPrim = "World"\n{metres}\nupAxis = "{self.up}"\n)\n'
        path.write_text(text + self.group("World", body), encoding="utf-8")
        return path


def room_body(text: StageText, things: str = "") -> str:
    """Returns floor and walls of a room from (-4, -3) to (4, 3), a red chair at (2, 1), and the prims `things`."""
    chair = text.group(
        "SM_Chair_01",
        text.box("Seat", (1.8, 0.8, 0.3), (2.2, 1.2, 0.45), (0.6, 0.01, 0.01))
        + text.box("Back", (1.8, 1.15, 0.45), (2.2, 1.2, 0.9), (0.6, 0.01, 0.01))
        + text.box("Foot", (1.95, 0.95, 0.0), (2.05, 1.05, 0.3), (0.6, 0.01, 0.01)),
    )
    walls = (
        text.box("WallWest", (-4.2, -3.2, 0), (-4, 3.2, 2.5))
        + text.box("WallEast", (4, -3.2, 0), (4.2, 3.2, 2.5))
        + text.box("WallSouth", (-4, -3.2, 0), (4, -3, 2.5))
        + text.box("WallNorth", (-4, 3, 0), (4, 3.2, 2.5))
    )
    return text.box("Floor", (-4.2, -3.2, -0.1), (4.2, 3.2, 0.0)) + walls + chair + things
