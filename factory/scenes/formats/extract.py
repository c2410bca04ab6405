"""Extracts the content of a scene file of any format; USD is read by `scenes.importer`.

Chooses the reader by the content of the file. Does not assign categories and builds no collider.
"""

from __future__ import annotations

import struct
import warnings
import zlib
from pathlib import Path

from factory.scenes.formats.files import SceneFiles
from factory.scenes.formats.library import read_mesh_file
from factory.scenes.formats.sdf import read_sdf
from factory.scenes.formats.shapes import BROKEN, ROOT, place_content, resolve_units
from factory.scenes.formats.urdf import read_urdf
from factory.scenes.importer import Extraction
from factory.scenes.importer.collect import Collector
from factory.scenes.importer.extract import extract_stage
from factory.scenes.limits import USUAL_LIMITS, StageLimits
from factory.scenes.stage_file import kind_of_file, require_stage
from schemas.errors import UsageError, WorldError
from schemas.support.extras import require_package

_WORLDS = ("SDF", "URDF", "MJCF")
_UNREADABLE = (*BROKEN, OSError, EOFError, AssertionError, Warning, MemoryError, struct.error, zlib.error)


def extract_scene(path: Path, limits: StageLimits = USUAL_LIMITS) -> Extraction:
    """Extracts the content of a scene file.

    Args:
        path: root file: USD, glTF, OBJ, PLY, STL, COLLADA, SDFormat, URDF or MJCF.
        limits: options of the import.

    Raises:
        UsageError: the file does not exist or has a different format, or does not state its unit or up axis.
        WorldError: the file cannot be read, names files that are missing, or exceeds a limit.
    """
    require_stage(path)
    kind = kind_of_file(path)
    if kind in ("USD", *_WORLDS) and (limits.unit or limits.up):
        raise UsageError(f"{path.name} is {kind}, which defines its unit and up axis; remove --unit and --up")
    if kind == "USD":
        return extract_stage(path, limits)
    scene = Collector(path.name, limits)
    scene.groups.add(ROOT)
    files = SceneFiles(path, scene)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # numpy warns of malformed numbers
            metres = _read(kind, path, files)
    except _UNREADABLE as error:
        reason = " ".join(str(error).split())[:300] or type(error).__name__
        raise WorldError(f"{path.name} is not a readable {kind} file: {reason}") from error
    if all(part.is_collider for part in scene.parts):
        scene.notes.append("no visible triangles in the file")
    return scene.extraction(metres, files.digests_with_textures(scene.parts), files.images)


def _read(kind: str, path: Path, files: SceneFiles) -> float:
    """Reads a file into the scene of `files`. Returns the length of its unit, metres."""
    if kind == "SDF":
        read_sdf(path, files)
    elif kind == "URDF":
        read_urdf(path, files)
    elif kind == "MJCF":
        require_package("mujoco", "importing MJCF")
        from factory.scenes.formats.mjcf import read_mjcf  # imports an optional package

        read_mjcf(path, files)
    else:
        content = read_mesh_file(path, files)
        matrix, metres = resolve_units(path.name, content, files.scene.limits)
        place_content(files.scene, ROOT, content, matrix)
        return metres
    return 1.0
