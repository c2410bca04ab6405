"""Appearance of MuJoCo's geoms: colour, emission, and textures of planes and of meshes with texture coordinates."""

from __future__ import annotations

import io
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from factory.scenes.formats.files import SceneFiles
from factory.scenes.formats.shapes import display_colour
from factory.scenes.importer.model import Surface

_COLOUR_ROLES = (mujoco.mjtTextureRole.mjTEXROLE_RGB, mujoco.mjtTextureRole.mjTEXROLE_RGBA)


def read_surface(model: Any, files: SceneFiles, geom: int) -> Surface:
    """Returns the appearance of a geom. The mean colour replaces a texture that MuJoCo projects on a solid.

    Args:
        model: compiled model.
        files: files of the import; receives the textures as images.
        geom: number of the geom.
    """
    material = int(model.geom_matid[geom])
    if material < 0:
        *rgb, alpha = (float(value) for value in model.geom_rgba[geom])
        return _plain(rgb, alpha, 0.0)
    *rgb, alpha = (float(value) for value in model.mat_rgba[material])
    surface = replace(_plain(rgb, alpha, float(model.mat_emission[material])), name=model.mat(material).name)
    texture = max(int(model.mat_texid[material][int(role)]) for role in _COLOUR_ROLES)
    if texture < 0:
        return surface
    pixels = _pixels(model, texture)
    if not _has_coordinates(model, geom) or int(model.tex_type[texture]) != mujoco.mjtTexture.mjTEXTURE_2D:
        mean = display_colour(*(pixels.reshape(-1, pixels.shape[-1])[:, :3].mean(axis=0) / 255.0))
        red, green, blue = (float(a * b) for a, b in zip(mean, surface.colour, strict=True))
        return replace(surface, colour=(red, green, blue), fallback=(red, green, blue))
    name = f"{files.root.name}[texture {model.texture(texture).name or texture}]"
    if name not in files.images:
        encoded = io.BytesIO()
        Image.fromarray(pixels[..., :3]).save(encoded, "PNG")
        files.images[name] = encoded.getvalue()
    return replace(surface, texture=name)


def _plain(rgb: list[float], alpha: float, glow: float) -> Surface:
    red, green, blue = colour = display_colour(*rgb)
    emission = (glow * red, glow * green, glow * blue)
    return Surface(colour, "", colour, opacity=alpha, emits=glow > 0.05, emission=emission)


def _has_coordinates(model: Any, geom: int) -> bool:
    kind, mesh = int(model.geom_type[geom]), int(model.geom_dataid[geom])
    is_mesh = kind == mujoco.mjtGeom.mjGEOM_MESH
    return kind == mujoco.mjtGeom.mjGEOM_PLANE or (is_mesh and int(model.mesh_texcoordadr[mesh]) >= 0)


def _pixels(model: Any, texture: int) -> NDArray[np.uint8]:
    """Returns a texture (height, width, channels), top row first."""
    sizes = (model.tex_height, model.tex_width, model.tex_nchannel)
    height, width, channels = (int(values[texture]) for values in sizes)
    first = int(model.tex_adr[texture])
    flat = model.tex_data[first : first + height * width * channels]
    return np.asarray(flat, np.uint8).reshape(height, width, channels)
