"""Reads MJCF with MuJoCo, which resolves includes, defaults, frames and orientations: geoms in their initial pose.

The names of all files, also of includes, are checked before MuJoCo opens them. Joints, actuators and lights are not
kept.
"""

from __future__ import annotations

import io
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from factory.scenes.formats.files import SceneFiles, place_of
from factory.scenes.formats.shapes import BROKEN, LIGHTS_NOTE, ROOT, Names, display_colour, mesh_piece, solid_piece
from factory.scenes.importer.collect import Piece
from factory.scenes.importer.content import Surface
from factory.scenes.importer.solids import box, capsule, cylinder, plane, sphere
from schemas.support.numpy_types import Floats

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element


_FOLDER_OF = {"mesh": "meshdir", "skin": "meshdir", "hfield": "assetdir", "texture": "texturedir"}
_MOST_FILES = 20_000


def require_files(path: Path, files: SceneFiles) -> None:
    """Reads an MJCF file with its includes, and checks that its assets are inside the folders of the import.

    Args:
        path: main file.
        files: files of the import; receives the digests.

    Raises:
        ValueError: a file is malformed, contains entities or includes itself.
        WorldError: files are missing, outside of the folders, or too large; the message names all.
    """
    elements: list[tuple[Element, Path]] = []
    _collect(path, path.parent, files=files, elements=elements, above=())
    folders = {"assetdir": "", "strippath": "false"}
    for element, _ in elements:
        if element.tag == "compiler":
            shared = element.get("assetdir")
            folders |= {} if shared is None else {"meshdir": shared, "texturedir": shared}
            folders |= element.attrib
    for element, beside in elements:
        for key, value in element.attrib.items():
            if key.startswith("file") and element.tag not in ("include", "mujoco") and value:
                folder = folders.get(_FOLDER_OF.get(element.tag, ""), folders["assetdir"])
                name = Path(value).name if folders["strippath"] == "true" else value
                place = _first_of(path.parent, str(Path(folder) / name), beside, name)
                if files.is_usable(place, f"{element.tag} {element.get('name', '')}".strip()):
                    files.read(place)
    files.require_all(may_skip=False)


def _first_of(folder: Path, reference: str, beside: Path, name: str) -> Path:
    """Returns the place of a file as MuJoCo finds it: from the main file, or else from the file that names it."""
    place, other = place_of(folder, reference), place_of(beside, name)
    return other if other.is_file() and not place.is_file() else place


def _collect(
    path: Path, folder: Path, files: SceneFiles, elements: list[tuple[Element, Path]], above: tuple[Path, ...]
) -> None:
    """Adds the elements of a file and of its includes, in document order, each with the folder of its file."""
    if path in above:
        raise ValueError(f"{path.name} includes itself")
    if len(above) > 50 or len(files.digests) > _MOST_FILES:
        raise ValueError("its includes are nested too deeply")
    # in document order, as MuJoCo reads them: the last <compiler> applies to all assets
    for element in files.read_xml(path).iter():
        elements.append((element, path.parent))
        if element.tag == "include":
            name = str(element.get("file") or "")
            place = _first_of(folder, name, path.parent, name)
            if files.is_usable(place, path.name):
                _collect(place, folder, files=files, elements=elements, above=(*above, path))


_SHOWN_GROUPS = 3
"""Geoms of groups 0 to 2 are visible in MuJoCo's viewer; those of groups 3 to 5 are for collision."""
_SOLID_GROUP = 0
"""Geoms of this group are visible, unless geoms of other visible groups that do not collide stand for them."""
_READER_VERSION = "mjcf 2"
"""Set for a model of which version 1 hid every geom of group 0 beside a decoration."""
_STAND_IN_M = 0.1
"""A geom of group 0 that collides is for collision only if the visible geoms of its body that do not collide enclose
its box, with this margin, metres. A lamp on a wall does not stand for the wall."""


def read_mjcf(path: Path, files: SceneFiles) -> None:
    """Reads a model into the scene of `files`.

    Args:
        path: .xml or .mjcf file.
        files: files of the import.

    Raises:
        ValueError: the file is malformed, or MuJoCo cannot compile it.
        WorldError: files are missing or outside of the folder; the message names all.
    """
    require_files(path, files)
    try:
        model = mujoco.MjModel.from_xml_path(str(path))
    except (ValueError, mujoco.FatalError) as error:
        raise ValueError(f"MuJoCo cannot compile it: {' '.join(str(error).split())}") from error
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    names = Names()
    paths = _body_paths(model, names)
    _mark_models(model, files, paths)
    decorated = _boxes_of_decoration(model, data)
    for geom in range(model.ngeom):
        kind = mujoco.mjtGeom(model.geom_type[geom]).name.removeprefix("mjGEOM_").lower()
        prim = names.path(paths[int(model.geom_bodyid[geom])], model.geom(geom).name, kind)
        try:
            is_proxy = _is_proxy(model, data, geom, decorated)
            if not is_proxy and _was_hidden(model, geom, decorated):
                files.scene.reader_version = _READER_VERSION
            _place(model, data, files, geom, prim, is_proxy)
        except BROKEN as error:
            files.scene.notes.append(f"{prim}: skipped, {error}")
    if model.nlight:
        files.scene.notes.append(f"{model.nlight} {LIGHTS_NOTE}")


def _body_paths(model: Any, names: Names) -> dict[int, str]:
    paths = {0: ROOT}
    for body in range(1, model.nbody):  # a parent has a smaller number than its children
        paths[body] = names.path(paths[int(model.body_parentid[body])], model.body(body).name, "body")
    return paths


def _mark_models(model: Any, files: SceneFiles, paths: dict[int, str]) -> None:
    """Marks the outermost bodies as objects; a body without geoms, with several bodies in it, is a group."""
    groups = {0}
    for body in range(1, model.nbody):
        if int(model.body_parentid[body]) in groups:
            is_group = not model.body_geomnum[body] and int((model.body_parentid == body).sum()) > 1
            if is_group:
                groups.add(body)
            (files.scene.groups if is_group else files.scene.models).add(paths[body])


def _collides(model: Any, geom: int) -> bool:
    return bool(model.geom_contype[geom] or model.geom_conaffinity[geom])


def _decorates(model: Any, geom: int) -> bool:
    return _SOLID_GROUP < int(model.geom_group[geom]) < _SHOWN_GROUPS and not _collides(model, geom)


def _boxes_of_decoration(model: Any, data: Any) -> dict[int, Floats]:
    """Returns the bounding box (2, 3), world metres, of the decoration of each body but the world."""
    boxes: dict[int, Floats] = {}
    for geom in range(model.ngeom):
        body = int(model.geom_bodyid[geom])
        if body and _decorates(model, geom):
            box = _box_of(model, data, geom)
            known = boxes.get(body, box)
            boxes[body] = np.stack([np.minimum(known[0], box[0]), np.maximum(known[1], box[1])])
    return boxes


def _is_proxy(model: Any, data: Any, geom: int, decorated: dict[int, Floats]) -> bool:
    is_plane = int(model.geom_type[geom]) == mujoco.mjtGeom.mjGEOM_PLANE
    if is_plane or not _was_hidden(model, geom, decorated) or not _collides(model, geom):
        return False
    box, outer = _box_of(model, data, geom), decorated[int(model.geom_bodyid[geom])]
    return bool((box[0] >= outer[0] - _STAND_IN_M).all() and (box[1] <= outer[1] + _STAND_IN_M).all())


def _was_hidden(model: Any, geom: int, decorated: dict[int, Floats]) -> bool:
    return int(model.geom_group[geom]) == _SOLID_GROUP and int(model.geom_bodyid[geom]) in decorated


def _box_of(model: Any, data: Any, geom: int) -> Floats:
    """Returns the bounding box (2, 3) of a geom, world metres."""
    centre, half = model.geom_aabb[geom].reshape(2, 3)
    turn = data.geom_xmat[geom].reshape(3, 3)
    middle, reach = turn @ centre + data.geom_xpos[geom], np.abs(turn) @ half
    return np.stack([middle - reach, middle + reach])


def _place(model: Any, data: Any, files: SceneFiles, geom: int, path: str, is_proxy: bool) -> None:
    surface = read_surface(model, files, geom)
    is_shown = int(model.geom_group[geom]) < _SHOWN_GROUPS and surface.opacity > 0.0 and not is_proxy
    collides = _collides(model, geom)
    is_plane = int(model.geom_type[geom]) == mujoco.mjtGeom.mjGEOM_PLANE
    if not is_shown and (is_plane or not collides):
        return
    piece = geom_piece(model, geom, surface)
    if piece is None:
        files.scene.notes.append(f"{path}: this type of geom is not supported, skipped")
        return
    to_world = np.eye(4)
    to_world[:3, :3], to_world[:3, 3] = data.geom_xmat[geom].reshape(3, 3), data.geom_xpos[geom]
    files.scene.place(path, [piece], to_world, is_collider=not is_shown)


_INFINITE_M = 25.0
"""Half length that replaces the infinite side of a plane, metres."""
_GEOM = mujoco.mjtGeom


def geom_piece(model: Any, geom: int, surface: Surface) -> Piece | None:
    """Returns the triangles of a geom, or `None` for types that are not supported.

    Args:
        model: compiled model.
        geom: number of the geom.
        surface: its appearance.

    Raises:
        ValueError: its points are not finite.
    """
    kind, data = int(model.geom_type[geom]), int(model.geom_dataid[geom])
    x, y, z = (float(value) for value in model.geom_size[geom])
    if kind == _GEOM.mjGEOM_MESH:
        return _mesh(model, data, surface)
    if kind == _GEOM.mjGEOM_HFIELD:
        return _height_field(model, data, surface)
    if kind == _GEOM.mjGEOM_PLANE:
        return _plane(model, geom, (x or _INFINITE_M, y or _INFINITE_M), surface)
    if kind == _GEOM.mjGEOM_ELLIPSOID:
        points, counts, indices = sphere(1.0)
        return solid_piece((points * (x, y, z), counts, indices), surface)
    solids = {
        int(_GEOM.mjGEOM_BOX): lambda: box(x, y, z),
        int(_GEOM.mjGEOM_SPHERE): lambda: sphere(x),
        int(_GEOM.mjGEOM_CYLINDER): lambda: cylinder(x, x, y),
        int(_GEOM.mjGEOM_CAPSULE): lambda: capsule(x, x, y),
    }
    return solid_piece(solids[kind](), surface) if kind in solids else None


def _mesh(model: Any, mesh: int, surface: Surface) -> Piece:
    first, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
    rows = slice(int(model.mesh_faceadr[mesh]), int(model.mesh_faceadr[mesh]) + int(model.mesh_facenum[mesh]))
    points = np.asarray(model.mesh_vert[first : first + count], np.float64)
    uvs, first_uv = None, int(model.mesh_texcoordadr[mesh])
    if surface.texture and first_uv >= 0:
        uvs = np.asarray(model.mesh_texcoord, np.float64)[first_uv + model.mesh_facetexcoord[rows]]
        uvs = np.stack([uvs[..., 0], 1.0 - uvs[..., 1]], axis=-1)
    return mesh_piece(points, np.asarray(model.mesh_face[rows], np.int64), surface, uvs)


def _height_field(model: Any, field: int, surface: Surface) -> Piece:
    """Returns the surface of a height field, without its base and sides."""
    rows, columns, first = int(model.hfield_nrow[field]), int(model.hfield_ncol[field]), int(model.hfield_adr[field])
    half_x, half_y, top, _ = (float(value) for value in model.hfield_size[field])
    heights = np.asarray(model.hfield_data[first : first + rows * columns], np.float64) * top
    y, x = np.meshgrid(np.linspace(-half_y, half_y, rows), np.linspace(-half_x, half_x, columns), indexing="ij")
    number = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = (part.ravel() for part in (number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]))
    corners = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    return mesh_piece(np.stack([x.ravel(), y.ravel(), heights], axis=1), corners, surface, is_two_sided=True)


def _plane(model: Any, geom: int, half: tuple[float, float], surface: Surface) -> Piece:
    points, _, _ = plane(*half)
    corners = np.array([[0, 1, 2], [0, 2, 3]])
    uvs, material = None, int(model.geom_matid[geom])
    if surface.texture:
        repeat = np.asarray(model.mat_texrepeat[material], np.float64)
        size = 2.0 * np.array(half) if model.mat_texuniform[material] else np.ones(2)
        uvs = (points[:, :2] / (2.0 * np.array(half)) + 0.5)[corners] * repeat * size
    return mesh_piece(points, corners, surface, uvs, is_two_sided=False)


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
