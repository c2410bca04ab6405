"""Detects the format of scene files by their first bytes, and suggests a converter for formats that are not read.

Reads the beginning of one file. Does not open scenes and does not need USD.
"""

from __future__ import annotations

import json
import re
import shlex
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

from schemas.errors import UsageError

STAGE_SUFFIXES = (".usd", ".usda", ".usdc", ".usdz")
_READ_BYTES = 1 << 16
SCENE_SUFFIXES = (
    *STAGE_SUFFIXES,
    *(".gltf", ".glb", ".obj", ".ply", ".stl", ".dae", ".sdf", ".world", ".urdf", ".mjcf", ".xml"),
)
_READ = ("glTF", "OBJ", "PLY", "STL", "COLLADA", "SDF", "URDF", "MJCF")
_SUPPORTED = f"supported are {', '.join(SCENE_SUFFIXES)}"
_USD: Mapping[str, tuple[bytes, tuple[str, ...]]] = MappingProxyType(
    {
        "a USD text layer": (b"#usda ", (".usd", ".usda")),
        "a USD crate": (b"PXR-USDC", (".usd", ".usdc")),
        "a zip archive": (b"PK\x03\x04", (".usdz",)),
    }
)
"""Format -> its magic bytes, and the suffixes that USD accepts for it; the preferred suffix is last."""
_MAGIC: Mapping[bytes, str] = MappingProxyType(
    {
        b"glTF": "glTF",
        b"Kaydara FBX Binary": "FBX",
        b"; FBX": "FBX",
        b"BLENDER": "Blender",
        b"ply\n": "PLY",
        b"ply\r\n": "PLY",
    }
)
_ROOT_ELEMENTS: Mapping[str, str] = MappingProxyType(
    {
        "COLLADA": "COLLADA",
        "sdf": "SDF",
        "gazebo": "SDF",
        "world": "SDF",
        "robot": "URDF",
        "mujoco": "MJCF",
        "mujocoinclude": "MJCF",
    }
)
_SUFFIXES: Mapping[str, str] = MappingProxyType(
    {
        ".gltf": "glTF",
        ".glb": "glTF",
        ".fbx": "FBX",
        ".obj": "OBJ",
        ".dae": "COLLADA",
        ".blend": "Blender",
        ".ply": "PLY",
        ".stl": "STL",
        ".sdf": "SDF",
        ".world": "SDF",
        ".urdf": "URDF",
        ".xacro": "URDF",
        ".mjcf": "MJCF",
    }
)
_CONVERTERS: Mapping[str, str] = MappingProxyType({"FBX": "import_scene.fbx", "Blender": ""})
"""Format -> Blender operator that imports it; empty for Blender's own files."""
_LFS = b"version https://git-lfs"
_COMMENT = re.compile(r"<!--.*?(?:-->|\Z)", re.DOTALL)
_ELEMENT = re.compile(r"<([A-Za-z_][\w.-]*)")


def require_stage(path: Path) -> None:
    """Checks that a file can be a scene of a supported format.

    Raises:
        UsageError: the file does not exist, is a directory or has a different format; the message names a converter.
    """
    fault = find_fault(path)
    if fault:
        raise UsageError(fault)


def find_fault(path: Path) -> str:
    """Returns the reason why a file is not a scene, with a remedy, or an empty string if it can be one.

    Args:
        path: path as given by the user; messages quote it.
    """
    if path.is_dir():
        return f"{path} is a directory; give the scene's root file, a file in it ({_SUPPORTED})"
    if not path.is_file():
        return f"no scene file at {path}; give the path of a scene's root file"
    try:
        head = _head(path)
    except OSError as error:
        return f"cannot read {path} ({error.strerror}); check its permissions"
    return _find_problem(path, head)


def kind_of_file(path: Path) -> str:
    """Returns the format of a file: `USD`, `glTF`, `OBJ`, `PLY`, `STL`, `COLLADA`, `SDF`, `URDF` or `MJCF`, or another.

    The first bytes have precedence over the suffix. Empty for an unknown format or a file that cannot be read.
    """
    suffix = path.suffix.lower()
    try:
        return _kind_of(_head(path)) or ("USD" if suffix in STAGE_SUFFIXES else _SUFFIXES.get(suffix, ""))
    except OSError:
        return ""


def _head(path: Path) -> bytes:
    with path.open("rb") as file:
        return file.read(_READ_BYTES)


def _find_problem(path: Path, head: bytes) -> str:
    suffix = path.suffix.lower()
    for kind, (magic, suffixes) in _USD.items():
        if head.startswith(magic) and (kind != "a zip archive" or suffix in STAGE_SUFFIXES):
            wanted = path.with_suffix(suffixes[-1]).name
            return "" if suffix in suffixes else f"{path} contains {kind}, which USD opens as {wanted}; rename the file"
    if head.startswith(_LFS):
        return f"{path} is a pointer of Git LFS, not the file itself; fetch it with: git lfs pull"
    foreign = _kind_of(head)
    if foreign and suffix in STAGE_SUFFIXES:
        remedy = "rename the file" if foreign in _READ else _remedy(path, foreign)
        return f"{path} contains {foreign}, but has the suffix of a USD stage; {_SUPPORTED}; {remedy}"
    kind = foreign or _SUFFIXES.get(suffix, "")
    if kind in _READ or suffix in STAGE_SUFFIXES:
        return ""  # the reader reports errors in the content
    what = f"is {kind}, which is not read" if kind else "is not a scene"
    return f"{path} {what}; {_SUPPORTED}; {_remedy(path, kind)}"


def _kind_of(head: bytes) -> str:
    """Returns the format detected from the first bytes, or an empty string."""
    for magic, kind in _MAGIC.items():
        if head.startswith(magic):
            return kind
    text = head.decode("utf-8-sig", errors="replace").lstrip()
    if text.startswith("<"):
        root = _ELEMENT.search(_COMMENT.sub("", text))
        return _ROOT_ELEMENTS.get(root[1], "XML") if root else "XML"
    return "glTF" if text.startswith("{") and _names_gltf(text) else ""


def _names_gltf(text: str) -> bool:
    """Returns whether a text is glTF: JSON with the key `asset`. A truncated document is searched for typical keys."""
    try:
        document = json.loads(text)
    except ValueError:
        return re.search(r'"asset"\s*:\s*\{', text) is not None or '"bufferViews"' in text
    return isinstance(document, dict) and "asset" in document


def _remedy(path: Path, kind: str) -> str:
    if kind not in _CONVERTERS:
        return "export it as glTF or USD from the program that created it"
    export = f"bpy.ops.export_scene.gltf(filepath={path.stem + '.glb'!r})"
    if kind == "Blender":
        return f"convert it: blender --background {shlex.quote(path.name)} --python-expr {_quoted(export)}"
    read = f"bpy.ops.{_CONVERTERS[kind]}(filepath={path.name!r})"
    script = f"import bpy; bpy.ops.wm.read_factory_settings(use_empty=True); {read}; {export}"
    return f"convert it: blender --background --python-expr {_quoted(script)}"


def _quoted(script: str) -> str:
    return f'"{script}"' if not set(script) & set('"$`\\!') else shlex.quote(script)
