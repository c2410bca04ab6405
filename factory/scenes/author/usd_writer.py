"""Writes a floor plan as USD: one root layer, one layer per prop model, and textures as PNG.

Does not lay out scenes.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Gf, Kind, Sdf, Usd, UsdGeom, UsdShade, Vt

from factory.scenes.author.content import by_material, encode_texture
from factory.scenes.author.geometry import AuthoredMesh, merge
from factory.scenes.author.materials import PropPiece, SurfaceMaterial, linear_rgb
from factory.scenes.author.placement import FloorPlan, PropPlacement
from factory.scenes.author.props.catalogue import PropModel


def write_scene(plan: FloorPlan, name: str, directory: Path, metres_per_unit: float) -> Path:
    """Writes `<name>.usdc`, `props/*.usdc` and `textures/*.png` below a directory.

    Args:
        plan: floor plan of the scene, metres.
        name: stem of the root layer.
        directory: created if missing.
        metres_per_unit: length of one stage unit, metres.

    Returns:
        Path of the root layer.
    """
    (directory / "props").mkdir(parents=True, exist_ok=True)
    (directory / "textures").mkdir(exist_ok=True)
    models = {placement.model.name: placement.model for placement in plan.placements}
    for model in models.values():
        _write_model(model, directory / "props", metres_per_unit)
    pieces = [piece for structure in plan.structures for piece in structure.pieces]
    pieces += [piece for model in models.values() for piece in model.pieces]
    _write_textures(pieces, directory / "textures")
    path = directory / f"{name}.usdc"
    stage = _new_stage(path, "World", metres_per_unit)
    looks = _write_looks(stage, "/World/Looks", [p for s in plan.structures for p in s.pieces], "./textures")
    UsdGeom.Xform.Define(stage, "/World/Building")
    for structure in plan.structures:
        UsdGeom.Xform.Define(stage, f"/World/Building/{structure.name}")
        _write_meshes(
            stage,
            f"/World/Building/{structure.name}",
            pieces=structure.pieces,
            looks=looks,
            metres_per_unit=metres_per_unit,
        )
    UsdGeom.Xform.Define(stage, "/World/Props")
    for number, placement in enumerate(plan.placements):
        _write_placement(stage, placement, number, metres_per_unit)
    stage.GetRootLayer().Save()
    return path


def _new_stage(path: Path, root: str, metres_per_unit: float) -> Any:
    layer = Sdf.Layer.Find(str(path))
    if layer:
        layer.Clear()  # a layer of an earlier scene at this path can be open in this process
        stage = Usd.Stage.Open(layer)
    else:
        stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageMetersPerUnit(stage, metres_per_unit)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    prim = UsdGeom.Xform.Define(stage, f"/{root}").GetPrim()
    stage.SetDefaultPrim(prim)
    return stage


def _write_model(model: PropModel, directory: Path, metres_per_unit: float) -> None:
    stage = _new_stage(directory / f"{model.name}.usdc", model.name, metres_per_unit)
    Usd.ModelAPI(stage.GetDefaultPrim()).SetKind(Kind.Tokens.component)
    looks = _write_looks(stage, f"/{model.name}/Looks", model.pieces, "../textures")
    _write_meshes(stage, f"/{model.name}", pieces=model.pieces, looks=looks, metres_per_unit=metres_per_unit)
    stage.GetRootLayer().Save()


def _write_meshes(
    stage: Any, parent: str, pieces: Sequence[PropPiece], looks: dict[str, Any], metres_per_unit: float
) -> None:
    """Writes one mesh prim per material below `parent`."""
    for number, (name, group) in enumerate(by_material(pieces).items()):
        joined = merge([piece.mesh for piece in group], group[0].material.tile_m)
        mesh = _write_mesh(stage, f"{parent}/Geo_{number}", joined, metres_per_unit)
        UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(looks[name])


def _write_mesh(stage: Any, path: str, mesh: AuthoredMesh, metres_per_unit: float) -> Any:
    prim = UsdGeom.Mesh.Define(stage, path)
    points = (mesh.points / metres_per_unit).astype(np.float32)
    prim.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(points))
    prim.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(mesh.counts.astype(np.int32)))
    prim.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(mesh.indices.astype(np.int32)))
    prim.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    prim.CreateExtentAttr([Gf.Vec3f(*points.min(axis=0).tolist()), Gf.Vec3f(*points.max(axis=0).tolist())])
    if mesh.st is not None:
        primvar = UsdGeom.PrimvarsAPI(prim).CreatePrimvar(
            "st", Sdf.ValueTypeNames.TexCoord2fArray, UsdGeom.Tokens.faceVarying
        )
        primvar.Set(Vt.Vec2fArray.FromNumpy(mesh.st.astype(np.float32)))
    return prim


def _write_looks(stage: Any, scope: str, pieces: Iterable[PropPiece], textures: str) -> dict[str, Any]:
    """Defines every material once and returns the materials by name."""
    UsdGeom.Scope.Define(stage, scope)
    materials = {piece.material.name: piece.material for piece in pieces}
    return {name: _write_material(stage, scope, material, textures) for name, material in materials.items()}


def _write_material(stage: Any, scope: str, material: SurfaceMaterial, textures: str) -> Any:
    path = f"{scope}/M_{material.name}"
    look = UsdShade.Material.Define(stage, path)
    surface = UsdShade.Shader.Define(stage, f"{path}/Surface")
    surface.CreateIdAttr("UsdPreviewSurface")
    surface.CreateInput("roughness", Sdf.ValueTypeNames.Float).Set(material.roughness)
    surface.CreateInput("metallic", Sdf.ValueTypeNames.Float).Set(material.metallic)
    diffuse = surface.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f)
    rgb = linear_rgb(material.colour)
    image = None
    if material.texture is None:
        diffuse.Set(Gf.Vec3f(*rgb))
    else:
        image = _write_texture_reader(stage, path, f"{textures}/{material.texture}.png", material.tint)
        diffuse.ConnectToSource(image)
    if material.glow:
        emission = surface.CreateInput("emissiveColor", Sdf.ValueTypeNames.Color3f)
        if image is None:
            emission.Set(Gf.Vec3f(*(channel * material.glow for channel in rgb)))
        else:
            emission.ConnectToSource(image)
    look.CreateSurfaceOutput().ConnectToSource(surface.ConnectableAPI(), "surface")
    return look


def _write_texture_reader(stage: Any, path: str, file: str, tint: str | None) -> Any:
    """Writes a UsdUVTexture with the `st` primvar as input and the tint as factor; returns its rgb output."""
    reader = UsdShade.Shader.Define(stage, f"{path}/Reader")
    reader.CreateIdAttr("UsdPrimvarReader_float2")
    reader.CreateInput("varname", Sdf.ValueTypeNames.String).Set("st")
    texture = UsdShade.Shader.Define(stage, f"{path}/Texture")
    texture.CreateIdAttr("UsdUVTexture")
    texture.CreateInput("file", Sdf.ValueTypeNames.Asset).Set(file)
    texture.CreateInput("sourceColorSpace", Sdf.ValueTypeNames.Token).Set("sRGB")
    texture.CreateInput("wrapS", Sdf.ValueTypeNames.Token).Set("repeat")
    texture.CreateInput("wrapT", Sdf.ValueTypeNames.Token).Set("repeat")
    if tint is not None:
        texture.CreateInput("scale", Sdf.ValueTypeNames.Float4).Set(Gf.Vec4f(*linear_rgb(tint), 1.0))
    coordinates = reader.CreateOutput("result", Sdf.ValueTypeNames.Float2)
    texture.CreateInput("st", Sdf.ValueTypeNames.Float2).ConnectToSource(coordinates)
    return texture.CreateOutput("rgb", Sdf.ValueTypeNames.Float3)


def _write_placement(stage: Any, placement: PropPlacement, number: int, metres_per_unit: float) -> None:
    """Adds the prop layer as reference, instance or payload in turn, so tests of importers cover all three."""
    xform = UsdGeom.Xform.Define(stage, f"/World/Props/{placement.name}")
    place = np.array([placement.x, placement.y, placement.z]) / metres_per_unit
    xform.AddTranslateOp().Set(Gf.Vec3d(*place.tolist()))
    xform.AddRotateZOp().Set(math.degrees(placement.yaw))
    prim, layer = xform.GetPrim(), f"./props/{placement.model.name}.usdc"
    if number % 3 == 2:
        prim.GetPayloads().AddPayload(layer)
        return
    prim.GetReferences().AddReference(layer)
    prim.SetInstanceable(number % 3 == 1)


def _write_textures(pieces: Iterable[PropPiece], directory: Path) -> None:
    for name in sorted({piece.material.texture for piece in pieces if piece.material.texture}):
        (directory / f"{name}.png").write_bytes(encode_texture(name))
