"""Computes vertex colours (sRGB), emission, reflectance and materials of parts. Pure functions.

Does not compute illumination; `scenes.light` bakes it.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Sequence
from itertools import pairwise
from pathlib import PurePosixPath
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from factory.scenes.compile.textures import TextureBook
from factory.scenes.importer import Part, Surface
from factory.scenes.rules import split_name
from schemas.appearance.colour_names import dominant_name, linear_of, srgb_of
from schemas.scene import DRAWN, TEXTURE_SIZE_PX
from schemas.support.geometry import cross
from schemas.support.numpy_types import Floats

UNKNOWN = "unknown"
_MOST, _VISIBLE = 0.6, 0.05
"""The main material of an object covers at least the share `_MOST` of its surface. Every other listed material covers
at least the share `_VISIBLE`."""
_WORD = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])")
_SUBSTANCES = MappingProxyType(
    {
        "wood": "wood wooden oak walnut pine birch maple mahogany beech teak plywood hardwood timber",
        "metal": "metal metallic steel aluminium aluminum iron chrome chromium brass copper bronze stainless",
        "plastic": "plastic plastics polypropylene polyethylene pvc acrylic plexiglas",
        "glass": "glass",
        "fabric": "fabric cloth textile linen cotton wool velvet denim upholstery",
        "leather": "leather",
        "stone": "stone marble granite slate travertine sandstone limestone",
        "ceramic": "ceramic ceramics porcelain earthenware",
        "cardboard": "cardboard carton corrugated",
        "wicker": "wicker rattan",
        "rubber": "rubber",
        "paper": "paper",
        "concrete": "concrete cement",
        "brick": "brick bricks",
        "plaster": "plaster drywall stucco",
        "foam": "foam styrofoam",
        "leaf": "leaf leaves foliage",
        "soil": "soil earth",
    }
)
"""Words that name each substance, lower case. Words that are also colours, such as silver, are not listed."""
_BY_WORD = MappingProxyType({word: name for name, words in _SUBSTANCES.items() for word in words.split()})
_IMITATION = frozenset(("fake", "faux", "imitation", "look", "effect", "like", "spines", "holder", "frame"))
"""Words in a name that make its substance unknown, as in "fake leather" or "spines of leather books"."""


def substance_of(surface: Surface) -> str:
    """Returns the substance of a surface; `unknown` if its name states no substance or several."""
    # names, because colours cannot distinguish brown paint and oak
    names = (surface.name, PurePosixPath(surface.texture.replace("\\", "/")).stem)
    for name in names:  # the name of the material takes precedence over that of its texture
        words = {word.lower() for word in _WORD.findall(name)}
        substances = {_BY_WORD[word] for word in words if word in _BY_WORD}
        if words & _IMITATION:
            return UNKNOWN
        if substances:
            return substances.pop() if len(substances) == 1 else UNKNOWN
    return "metal" if surface.is_metal else UNKNOWN


def materials_of(parts: Sequence[Part], owners: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Returns the known materials of each object: first the one that covers most of it, then the others by name.

    Objects whose main material is unknown are omitted.

    Args:
        parts: visible parts.
        owners: path of the object of each part.
    """
    areas: dict[str, dict[str, float]] = defaultdict(lambda: defaultdict(float))
    for part, owner in zip(parts, owners, strict=True):
        areas[owner][substance_of(part.surface)] += float(triangle_areas(part.triangles).sum())
    materials = {}
    for owner, shares in areas.items():
        total, first = sum(shares.values()), max(shares, key=shares.__getitem__)
        most = shares[first]
        if first != UNKNOWN and total > 0 and most >= _MOST * total:
            others = sorted(name for name, area in shares.items() if name != first and area >= _VISIBLE * total)
            materials[owner] = (first, *others)
    return materials


_LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
_LAMP_WORDS = re.compile(r"(^|_)(lamp|light|screen|window)s?(_|$)")
_SAMPLES = 2000


def triangle_areas(triangles: Floats) -> Floats:
    """Returns the area (T,) of triangles (T, 3, 3)."""
    return np.asarray(np.linalg.norm(_crosses(triangles), axis=1) / 2)


def _crosses(triangles: Floats) -> Floats:
    return cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])


def texture_layer(part: Part, book: TextureBook) -> int:
    """Returns the texture layer of a part, or -1 for a plain colour."""
    return book.layer_of.get(part.surface.picture, -1) if part.uvs is not None else -1


def _base(part: Part, book: TextureBook) -> Floats:
    """Returns the linear colour of a part, broadcastable to (T, 3, 3). If the part has a texture layer, the colour
    is the factor by which the texture is multiplied."""
    surface = part.surface
    tint = np.array(surface.colour)
    if surface.texture and texture_layer(part, book) < 0:
        mean = book.mean_of.get(surface.picture)
        tint = np.array(surface.fallback) if mean is None else tint * mean
    return tint[None, None] if part.tints is None or surface.texture else part.tints[..., :3]


def glows_by_name(path: str) -> bool:
    """Returns whether the name of a prim or of its parent contains lamp, light, screen or window."""
    return any(_LAMP_WORDS.search(split_name(name)) for name in path.split("/")[-2:])


def corner_colours(part: Part, book: TextureBook) -> NDArray[np.uint8]:
    """Returns the sRGB colours (T, 3, 3) of the corners of a part in full light."""
    linear = _base(part, book) + np.array(part.surface.emission)
    srgb = np.broadcast_to(srgb_of(linear), part.triangles.shape)
    return np.rint(srgb * 255).astype(np.uint8)


def glow_brightness(part: Part, book: TextureBook) -> float:
    """Returns the linear luminance that a part emits, 0.01..1: that of its emission colour, else of its base colour."""
    colour = np.array(part.surface.emission)
    if not colour.any():
        colour = np.array(part.surface.colour) * book.mean_of.get(part.surface.picture, (1.0, 1.0, 1.0))
    return float(np.clip(colour @ _LUMINANCE, 0.01, 1.0))


def reflectance(part: Part, book: TextureBook) -> Floats:
    """Returns the linear luminance (T,), 0..1, of the triangles of a part in full light. A texture counts with
    its mean colour."""
    linear = np.broadcast_to(_base(part, book), part.triangles.shape).mean(axis=1)
    if texture_layer(part, book) >= 0:
        linear = linear * book.mean_of.get(part.surface.picture, (1.0, 1.0, 1.0))
    return np.asarray(np.clip(linear @ _LUMINANCE, 0.0, 1.0))


def target_colour(parts: list[Part], book: TextureBook) -> str:
    """Returns the colour name of an object, from samples on all faces that do not face down.

    Args:
        parts: parts of the object.
        book: textures of the scene.
    """
    rng = np.random.default_rng(0)
    crosses = [_crosses(part.triangles) for part in parts]
    areas = np.concatenate([np.linalg.norm(c, axis=1) * (c[:, 2] > -0.7 * np.linalg.norm(c, axis=1)) for c in crosses])
    if areas.sum() <= 0:
        return "unknown"
    chosen = np.sort(rng.choice(len(areas), _SAMPLES, p=areas / areas.sum()))
    firsts = np.cumsum([0, *(len(part.triangles) for part in parts)])
    samples = []
    for part, (first, last) in zip(parts, pairwise(firsts), strict=True):
        inside = chosen[(chosen >= first) & (chosen < last)] - first
        samples.append(_sample(part, book, inside, rng))
    colours = np.concatenate(samples)
    return dominant_name(colours) if len(colours) else "unknown"


def _sample(part: Part, book: TextureBook, triangles: NDArray[np.int64], rng: np.random.Generator) -> Floats:
    """Returns the unlit sRGB colour, 0..1, at one random point of each given triangle; without points in holes."""
    weights = rng.dirichlet((1.0, 1.0, 1.0), len(triangles))
    base = np.broadcast_to(_base(part, book), part.triangles.shape)[triangles]
    linear = np.einsum("nk,nkc->nc", weights, base)
    layer = texture_layer(part, book)
    if layer >= 0 and part.uvs is not None:
        uv = np.einsum("nk,nkc->nc", weights, part.uvs[triangles]) % 1.0
        side = TEXTURE_SIZE_PX
        columns = np.minimum((uv[:, 0] * side).astype(int), side - 1)
        rows = np.minimum(((1 - uv[:, 1]) * side).astype(int), side - 1)
        linear = linear * linear_of(book.layers[layer][rows, columns] / 255)
        if layer in book.masks:
            linear = linear[book.masks[layer][rows, columns] >= DRAWN]
    return srgb_of(linear)
