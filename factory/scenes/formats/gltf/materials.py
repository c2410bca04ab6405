"""Reads the materials of a glTF file: base colour, texture with its transform, opacity, emission.

Supports KHR_texture_transform, KHR_materials_emissive_strength, EXT_texture_webp and specular-glossiness colours.
"""

from __future__ import annotations

from dataclasses import replace
from math import cos, sin
from typing import Any

from factory.scenes.formats.gltf.buffers import Document
from factory.scenes.importer.model import Affine, Colour, Surface

_WHITE: Colour = (1.0, 1.0, 1.0)
_FLIP: Affine = (1.0, 0.0, 0.0, 0.0, -1.0, 1.0)
"""v of glTF starts at the top, v of the renderer at the bottom."""


def read_surface(document: Document, index: int | None, user: str) -> tuple[Surface, bool]:
    """Returns the appearance of a material, and whether its back faces are visible.

    Args:
        document: opened file.
        index: number of the material; `None` is the default material, white.
        user: node for notes.
    """
    if index is None:
        return Surface(colour=_WHITE), False
    material = document.item("materials", index)
    extensions = material.get("extensions") or {}
    glossy = extensions.get("KHR_materials_pbrSpecularGlossiness")
    base = glossy or material.get("pbrMetallicRoughness") or {}
    factor = [float(value) for value in base.get("diffuseFactor" if glossy else "baseColorFactor") or (1, 1, 1, 1)]
    red, green, blue, alpha = factor
    strength = float((extensions.get("KHR_materials_emissive_strength") or {}).get("emissiveStrength", 1.0))
    glow = [float(value) * strength for value in material.get("emissiveFactor") or (0, 0, 0)]
    is_image = "emissiveTexture" in material
    surface = Surface(
        colour=(red, green, blue),
        fallback=(red, green, blue),
        opacity=alpha if material.get("alphaMode") == "BLEND" else 1.0,
        emits=max(glow) > 0.05,
        emission=(0.0, 0.0, 0.0) if is_image else (glow[0], glow[1], glow[2]),
        name=str(material.get("name") or ""),
    )
    texture = base.get("diffuseTexture" if glossy else "baseColorTexture")
    if texture is not None:
        surface = _textured(document, surface, texture, user)
    return surface, bool(material.get("doubleSided", False))


def _textured(document: Document, surface: Surface, info: dict[str, Any], user: str) -> Surface:
    texture = document.item("textures", int(info["index"]))
    extensions = texture.get("extensions") or {}
    webp = extensions.get("EXT_texture_webp") or {}
    source = texture.get("source", webp.get("source"))
    if source is None:
        kinds = ", ".join(extensions) or "no image"
        document.files.scene.notes.append(f"{user}: texture of {kinds} is not supported, shown in one colour")
        return surface
    transform = (info.get("extensions") or {}).get("KHR_texture_transform") or {}
    full = replace(
        surface,
        texture=document.image(int(source)),
        uv_set=f"TEXCOORD_{int(transform.get('texCoord', info.get('texCoord', 0)))}",
        uv_affine=_affine(transform),
    )
    if full.texture in document.files.images:
        return full
    return document.files.readable.kept_inside(full, user, document.files.scene.notes)


def _affine(transform: dict[str, Any]) -> Affine:
    """Returns the transform of texture coordinates (KHR_texture_transform). In the result, v starts at the bottom."""
    if not transform:
        return _FLIP
    su, sv = (float(value) for value in transform.get("scale", (1.0, 1.0)))
    tu, tv = (float(value) for value in transform.get("offset", (0.0, 0.0)))
    angle = float(transform.get("rotation", 0.0))
    c, s = cos(angle), sin(angle)
    return (c * su, s * sv, tu, s * su, -c * sv, 1.0 - tv)
