"""Reads the base colour or texture of materials: preview surfaces, MaterialX and MDL.

Reads shading networks only. Does not decode textures. A mesh with an unsupported material is imported without it.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from math import cos, radians, sin
from typing import Any

from pxr import Sdf, UsdShade

from factory.scenes.importer.assets import asset_path, read_asset, sibling
from factory.scenes.importer.content import GRAY, Affine, Colour, Cutout, Surface

_WHITE: Colour = (1.0, 1.0, 1.0)
_BLACK: Colour = (0.0, 0.0, 0.0)
_SURFACES = ("UsdPreviewSurface", "ND_UsdPreviewSurface_surfaceshader", "ND_standard_surface_surfaceshader")
_MAX_HOPS = 16
_PASS_THROUGH = ("in", "in1", "diffuseColor", "base", "bg")
_MDL_COLOURS = (
    "diffuse_color_constant",
    "diffuseColor",
    "base_color",
    "baseColor",
    "diffuse_reflection_color",
    "diffuse_color",
    "albedo",
    "color",
    "diffuse_tint",
    "glass_color",
)
_BASE_NAME = re.compile(r"diffuse|albedo|base_?color", re.IGNORECASE)
_OTHER_NAME = re.compile(r"normal|_n\.|rough|metal|orm\b|_orm|_ao|occl|spec|mask|height|emis|opacity", re.IGNORECASE)
_MDL_TEXTURE = re.compile(r'(\w*)\s*:\s*texture_2d\(\s*"([^"]+)"')
_NUMBER = r"([\d.eE+-]+)f?"
_MDL_COLOUR = re.compile(
    rf"\w*(?:color|albedo|tint)\w*\s*:\s*(?:color|float3)\(\s*{_NUMBER}\s*,\s*{_NUMBER}\s*,\s*{_NUMBER}", re.IGNORECASE
)


def bound_material(prim: Any) -> Any | None:
    """Returns the material bound to a prim or subset, or `None`."""
    material = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial()[0]
    return material if material else None


def read_surface(material: Any, notes: list[str]) -> Surface | None:
    """Returns the appearance of a material, or `None` if none of its shaders is supported.

    Args:
        material: `UsdShade.Material`.
        notes: list that receives a note if no colour is found.
    """
    name, shader = material.GetPrim().GetName(), material.ComputeSurfaceSource()[0]
    if shader and shader.GetIdAttr().Get() in _SURFACES:
        return replace(_one_tile(material, _cut_out(shader, _preview(shader, notes)), notes), name=name)
    shader = material.ComputeSurfaceSource("mdl")[0]
    surface = _mdl_inputs(shader) or _mdl_text(shader) if shader else None
    if surface is None:
        notes.append(f"{material.GetPath()}: no colour found in its shaders")
    return None if surface is None else replace(surface, name=name)


def _cut_out(shader: Any, surface: Surface) -> Surface:
    """Returns the surface with the holes of its opacity texture below `opacityThreshold`."""
    threshold, picture = _value(shader, "opacityThreshold"), _end(shader, "opacity")
    if not threshold or not isinstance(picture, UsdShade.Shader):
        return surface
    file = _value(picture, "file")
    if file is None:
        return surface
    made_by = shader.GetInput("opacity").GetValueProducingAttributes()
    outputs = [str(each.GetName()).rpartition(":")[2] for each in made_by]
    channel = next((name for name in outputs if name in ("r", "g", "b", "a")), "a")
    cutout = Cutout(min(_scalar(threshold), 1.0), asset_path(file), channel, is_plain=not surface.texture)
    if surface.texture:
        return replace(surface, cutout=cutout)
    uv_set, affine = _uv_of(_first_input(picture, "st", "texcoord"))
    image = cutout.image
    return replace(surface, texture=image, fallback=surface.colour, uv_set=uv_set, uv_affine=affine, cutout=cutout)


def _first_input(shader: Any, *names: str) -> Any | None:
    return next((shader_input for name in names if (shader_input := shader.GetInput(name))), None)


def _preview(shader: Any, notes: list[str]) -> Surface:
    base = _first_input(shader, "diffuseColor", "base_color")
    end = _follow(base) if base else None
    surface = Surface()
    if isinstance(end, UsdShade.Shader):
        surface = _textured(end, notes)
    elif end is not None:
        surface = Surface(colour=_colour(end))
    opacity, metallic = _value(shader, "opacity"), _value(shader, "metallic")
    glow = _follow(shader.GetInput("emissiveColor")) if shader.GetInput("emissiveColor") else None
    is_image = isinstance(glow, UsdShade.Shader)
    emission = _BLACK if glow is None or is_image else _colour(glow)
    return replace(
        surface,
        opacity=1.0 if opacity is None else _scalar(opacity),
        emits=is_image or max(emission) > 0.05,
        emission=emission,
        is_metal=metallic is not None and _scalar(metallic) > 0.5,
    )


def _value(shader: Any, name: str) -> Any | None:
    """Returns the constant value of an input, or `None` if it is a texture or missing."""
    end = _end(shader, name)
    return None if isinstance(end, UsdShade.Shader) else end


def _end(shader: Any, name: str) -> Any | None:
    """Returns the constant value or the texture of an input, or `None` if it is missing."""
    shader_input = shader.GetInput(name)
    return _follow(shader_input) if shader_input else None


def _scalar(value: Any) -> float:
    return float(value) if not hasattr(value, "__len__") else float(sum(value) / len(value))


def _colour(value: Any) -> Colour:
    if not hasattr(value, "__len__"):
        value = (value, value, value)
    red, green, blue = (max(0.0, float(channel)) for channel in list(value)[:3])
    return (red, green, blue)


def _sources(connectable: Any) -> Any:
    return UsdShade.ConnectableAPI.GetConnectedSources(connectable)[0]


def _follow(end: Any, hops: int = 0) -> Any | None:
    """Follows an input or output through node graphs and arithmetic nodes to its constant or texture shader."""
    if not end or hops > _MAX_HOPS:
        return None
    sources = _sources(end)
    if not sources:
        return end.Get()
    source = sources[0]
    prim = source.source.GetPrim()
    if source.sourceType == UsdShade.AttributeType.Input:
        return _follow(UsdShade.Input(prim.GetAttribute(f"inputs:{source.sourceName}")), hops + 1)
    if prim.IsA(UsdShade.NodeGraph):
        return _follow(UsdShade.NodeGraph(prim).GetOutput(source.sourceName), hops + 1)
    return _through(UsdShade.Shader(prim), hops)


def _through(shader: Any, hops: int) -> Any | None:
    kind = shader.GetIdAttr().Get() or ""
    if "UVTexture" in kind or kind.startswith(("ND_image", "ND_tiledimage")):
        return shader
    inputs = (shader.GetInput(name) for name in _PASS_THROUGH)
    ends = (_follow(source, hops + 1) for source in inputs if source)
    return next((end for end in ends if end is not None), None)


def _one_tile(material: Any, surface: Surface, notes: list[str]) -> Surface:
    """Returns the surface with the first tile of a UDIM texture, which the renderer repeats."""
    # too few stages have UDIM textures to justify an atlas of all tiles
    if not UsdShade.UdimUtils.IsUdimIdentifier(surface.texture):
        return surface
    for spec in material.GetPrim().GetPrimStack():
        tiles = UsdShade.UdimUtils.ResolveUdimTilePaths(surface.texture, spec.layer)
        if tiles:
            notes.append(f"{material.GetPath()}: of {len(tiles)} UDIM tiles the first is shown everywhere")
            return replace(surface, texture=str(min(tiles, key=lambda tile: str(tile[1]))[0]), cutout=None)
    return surface


def _textured(shader: Any, notes: list[str]) -> Surface:
    file = _value(shader, "file")
    if file is None:
        notes.append(f"{shader.GetPath()}: a picture without a file, shown in one colour")
        return Surface()
    scale, fallback = _value(shader, "scale"), _value(shader, "fallback")
    uv_set, affine = _uv_of(_first_input(shader, "st", "texcoord"))
    return Surface(
        colour=_WHITE if scale is None else _colour(scale),
        texture=asset_path(file),
        fallback=GRAY if fallback is None else _colour(fallback),
        uv_set=uv_set,
        uv_affine=affine,
    )


def _uv_of(shader_input: Any | None) -> tuple[str, Affine | None]:
    """Returns the name of the primvar with the coordinates of a texture, and the 2-D transform of these coordinates."""
    affine: Affine | None = None
    for _ in range(_MAX_HOPS):
        sources = _sources(shader_input) if shader_input else []
        if not sources:
            break
        shader = UsdShade.Shader(sources[0].source.GetPrim())
        kind = shader.GetIdAttr().Get() or ""
        if "PrimvarReader" in kind or kind.startswith("ND_geompropvalue"):
            name = _value(shader, "varname") or _value(shader, "geomprop")
            return str(name or "st"), affine
        if kind != "UsdTransform2d":
            break
        affine = _affine(shader)
        shader_input = shader.GetInput("in")
    return "st", affine


def _affine(shader: Any) -> Affine:
    """Returns the transform: scale, then rotation (degrees, counter-clockwise), then translation."""
    su, sv = _value(shader, "scale") or (1.0, 1.0)
    angle = radians(float(_value(shader, "rotation") or 0.0))
    tu, tv = _value(shader, "translation") or (0.0, 0.0)
    return (su * cos(angle), -sv * sin(angle), tu, su * sin(angle), sv * cos(angle), tv)


def _mdl_inputs(shader: Any) -> Surface | None:
    """Returns the appearance from the inputs of an MDL shader."""
    textures, colours = {}, {}
    for shader_input in shader.GetInputs():
        value, name = shader_input.Get(), str(shader_input.GetBaseName())
        if isinstance(value, Sdf.AssetPath) and value.path:
            textures[name] = asset_path(value)
        elif name in _MDL_COLOURS and hasattr(value, "__len__") and len(value) >= 3:
            colours[name] = _colour(value)
    colour = next((colours[name] for name in _MDL_COLOURS if name in colours), None)
    texture = _base_texture(textures.items())
    if texture:
        tint = colours.get("diffuse_tint", _WHITE)
        return Surface(colour=tint, texture=texture, fallback=colour or GRAY)
    return None if colour is None else Surface(colour=colour)


def _base_texture(named: Any) -> str | None:
    """Returns the base colour texture, identified by parameter name or else by file name."""
    pairs = list(named)
    by_name = [path for name, path in pairs if _BASE_NAME.search(name) and not _OTHER_NAME.search(name)]
    by_file = [path for _, path in pairs if not _OTHER_NAME.search(path.rpartition("/")[2])]
    return next(iter(by_name + by_file), None)


def _mdl_files(shader: Any) -> Iterator[str]:
    asset = shader.GetSourceAsset("mdl")
    if not asset:
        return
    if asset.resolvedPath:
        yield str(asset.resolvedPath)
    for spec in shader.GetPrim().GetPrimStack():
        yield sibling(spec.layer.realPath or spec.layer.identifier, asset.path)


def _mdl_text(shader: Any) -> Surface | None:
    """Returns the appearance from the source text of the MDL module of a shader."""
    for path in _mdl_files(shader):
        data = read_asset(path)
        if data is None:
            continue
        text = data.decode(errors="replace")
        texture = _base_texture(_MDL_TEXTURE.findall(text))
        if texture:
            return Surface(colour=_WHITE, texture=sibling(path, texture))
        colour = _MDL_COLOUR.search(text)
        if colour:
            return Surface(colour=_colour([float(number) for number in colour.groups()]))
    return None
