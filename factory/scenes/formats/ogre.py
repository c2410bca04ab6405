"""Reads materials from scripts of Ogre (`.material`), the materials of Gazebo Classic: colours and the first texture.

Shaders, sphere maps and animations are ignored. The first technique and its first pass are used.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace

from factory.scenes.formats.shapes import display_colour
from factory.scenes.importer.content import Affine, Colour, Cutout, Surface

_COMMENT = re.compile(r"/\*.*?\*/|//[^\n]*", re.DOTALL)
_WORD = re.compile(r'"([^"\n]*)"|([{}])|(\n)|([^\s{}"]+)')
_SECTIONS = ("technique", "pass", "texture_unit")
_MOST_MATERIALS = 10_000
_DEEPEST = 20


@dataclass(frozen=True)
class OgreMaterial:
    """Appearance that a material script defines."""

    name: str
    ambient: Colour | None = None
    diffuse: Colour | None = None
    """Linear colours; `None` if the script does not state them."""
    emissive: Colour = (0.0, 0.0, 0.0)
    opacity: float = 1.0
    texture: str = ""
    """File name of the texture, as authored."""
    scale: tuple[float, float] = (1.0, 1.0)
    """Size of the texture along u and v: 2 shows half of it."""
    cut_below: float | None = None
    """Least opacity of the texture that is drawn, 0..1."""

    def surface(self) -> Surface:
        """Returns the material without its texture; white if the script states a texture and no colour."""
        plain = (1.0, 1.0, 1.0) if self.texture else display_colour(0.7, 0.7, 0.7)
        colour = self.diffuse or self.ambient or plain
        return Surface(
            *(colour, "", colour),
            opacity=self.opacity,
            emits=max(self.emissive) > 0.05,
            emission=self.emissive,
            name=self.name,
        )

    def textured(self, surface: Surface) -> Surface:
        """Returns a surface that has a texture, with the scale and the holes of this material."""
        if not surface.texture:
            return surface
        u, v = self.scale
        affine: Affine = (1 / u, 0.0, 0.5 - 0.5 / u, 0.0, 1 / v, 0.5 - 0.5 / v)  # Ogre scales about the centre
        cut = None if self.cut_below is None else Cutout(self.cut_below, surface.texture)
        return replace(surface, uv_affine=None if self.scale == (1.0, 1.0) else affine, cutout=cut)


def read_materials(text: str) -> dict[str, OgreMaterial]:
    """Returns the materials of a script by name.

    Args:
        text: content of a `.material` file.

    Raises:
        ValueError: a number is not valid, a block is not closed, or the script is too large; the message names the
            line.
    """
    materials: dict[str, OgreMaterial] = {}
    blocks: list[str] = []
    current: OgreMaterial | None = None
    passed: set[str] = set()
    for number, words in _lines(text):
        if words == ["}"]:
            if not blocks:
                raise ValueError(f"line {number}: a block is closed that was not opened")
            closed = blocks.pop()
            passed |= {closed} & {*_SECTIONS}
            if closed == "material" and current is not None:
                materials[current.name], current = current, None
        elif words[-1] == "{":
            blocks.append(words[0])
            if len(blocks) > _DEEPEST:
                raise ValueError(f"line {number}: blocks are nested more than {_DEEPEST} deep")
            if words[0] == "material":
                current, passed = _begun(words[1:-1], materials), set()
        elif current is not None and not _is_later(blocks, passed):
            try:
                current = _with_line(current, blocks[-1], words)
            except (ValueError, IndexError, ZeroDivisionError) as error:
                raise ValueError(f"line {number}: {' '.join(words)[:80]!r} is not valid") from error
    if blocks:
        raise ValueError(f"the block {blocks[-1]!r} is not closed")
    return materials


def _lines(text: str) -> Iterator[tuple[int, list[str]]]:
    """Yields the statements with their line numbers: words, the head of a block with `{` at its end, or `}`."""
    plain = _COMMENT.sub(lambda found: "\n" * found[0].count("\n"), text)
    words: list[str] = []
    head: tuple[int, list[str]] | None = None
    number = 1
    for found in _WORD.finditer(plain + "\n"):
        quoted, brace, newline, word = found.groups()
        if brace == "{":
            place, names = (number, words) if words else (head or (number, [""]))
            yield place, [*names, "{"]
            words, head = [], None
            continue
        if (brace or newline) and words:
            if head is not None:
                yield head
            head, words = (number, words), []  # the brace of a block may be in the next line
        if brace:
            if head is not None:
                yield head
            head = None
            yield number, ["}"]
        elif newline:
            number += 1
        else:
            words.append(word if quoted is None else quoted)
    if head is not None:
        yield head


def _begun(names: list[str], known: dict[str, OgreMaterial]) -> OgreMaterial:
    """Returns a new material; `material A : B` starts with the properties of B."""
    if len(known) >= _MOST_MATERIALS:
        raise ValueError(f"more than {_MOST_MATERIALS} materials")
    name, _, parent = " ".join(names).partition(":")
    base = known.get(parent.strip()) or OgreMaterial("")
    return replace(base, name=name.strip())


def _is_later(blocks: list[str], passed: set[str]) -> bool:
    """Returns whether the current block is a second technique, pass or texture unit."""
    return any(block in passed for block in blocks)


def _with_line(material: OgreMaterial, block: str, words: list[str]) -> OgreMaterial:
    key, *values = words
    if block == "pass" and key in ("ambient", "diffuse", "emissive") and values != ["vertexcolour"]:
        colour = display_colour(*(float(value) for value in values[:3]))
        if key == "ambient":
            return replace(material, ambient=colour)
        if key == "emissive":
            return replace(material, emissive=colour)
        opacity = min(max(float(values[3]), 0.0), 1.0) if len(values) > 3 else 1.0
        return replace(material, diffuse=colour, opacity=opacity)
    if block == "pass" and key == "alpha_rejection" and values[0] in ("greater", "greater_equal"):
        return replace(material, cut_below=min(max(float(values[1]) / 255, 0.0), 1.0))
    if block == "texture_unit" and key == "texture":
        return replace(material, texture=values[0])
    if block == "texture_unit" and key == "scale":
        u, v = float(values[0]), float(values[1])
        if not 1e-6 <= min(abs(u), abs(v)) <= max(abs(u), abs(v)) <= 1e6:
            raise ValueError(f"scale {u} {v}")
        return replace(material, scale=(u, v))
    return material
