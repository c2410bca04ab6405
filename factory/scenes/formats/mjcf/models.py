"""Reads MJCF with MuJoCo, which resolves includes, defaults, frames and orientations: geoms in their initial pose.

The names of all files are checked before MuJoCo opens them. Joints, actuators and lights are not kept.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from factory.scenes.formats.files import SceneFiles
from factory.scenes.formats.mjcf.files import require_files
from factory.scenes.formats.mjcf.pieces import geom_piece
from factory.scenes.formats.mjcf.surfaces import read_surface
from factory.scenes.formats.shapes import BROKEN, LIGHTS_NOTE, ROOT, Names

_SHOWN_GROUPS = 3
"""Geoms of groups 0 to 2 are visible in MuJoCo's viewer; those of groups 3 to 5 are for collision."""
_SOLID_GROUP = 0
"""Geoms of this group are visible. If their body also has visible geoms that do not collide, the geoms of this group
are for collision only."""


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
    decorated = {int(model.geom_bodyid[geom]) for geom in range(model.ngeom) if _decorates(model, geom)} - {0}
    for geom in range(model.ngeom):
        kind = mujoco.mjtGeom(model.geom_type[geom]).name.removeprefix("mjGEOM_").lower()
        own = names.path(paths[int(model.geom_bodyid[geom])], model.geom(geom).name, kind)
        try:
            is_proxy = int(model.geom_group[geom]) == _SOLID_GROUP and int(model.geom_bodyid[geom]) in decorated
            _place(model, data, files, geom, own, is_proxy)
        except BROKEN as error:
            files.scene.notes.append(f"{own}: skipped, {error}")
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
