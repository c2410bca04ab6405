"""Makes compiled scene packages on disk: the built-in scenes by name and seed, a user's USD by path.

Caches built-in packages by what they are made from; a package appears whole or not at all.
"""

from __future__ import annotations

import hashlib
import os
import re
import tempfile
from importlib.util import find_spec
from pathlib import Path

from factory.scenes.author import AUTHOR_VERSION, BUILTIN_SCENES, author_scene
from factory.scenes.rules import RuleBook, load_rules
from factory.scenes.version import COMPILER_VERSION
from schemas.errors import UsageError, WorldError
from schemas.scene import SCENE_FORMAT, CompiledScene, encode_scene

__all__ = ["build_scene", "import_scene", "package_path"]

_NAME = re.compile(r"[a-z][a-z0-9_]{0,63}")


def package_path(name: str, seed: int, cache: Path) -> Path:
    """Returns where the package of a built-in scene lies in a cache, whether it is there yet or not.

    Raises:
        UsageError: no built-in scene has that name.
    """
    if name not in BUILTIN_SCENES:
        known = ", ".join(BUILTIN_SCENES)
        raise UsageError(f"no built-in scene is called {name!r}; known: {known}; use `factory scene import` for a USD")
    made_from = (
        f"{name}\n{seed}\n{AUTHOR_VERSION}\n{COMPILER_VERSION}\n{SCENE_FORMAT}\n{load_rules().model_dump_json()}"
    )
    return cache / _file_name(name, hashlib.sha256(made_from.encode()).hexdigest())


def _file_name(name: str, digest: str) -> str:
    return f"{name}-{digest[:12]}.scene.zip"


def build_scene(name: str, seed: int, cache: Path) -> Path:
    """Authors and compiles a built-in scene unless the cache has it already.

    Args:
        name: one of `BUILTIN_SCENES`.
        seed: of the layout.
        cache: directory of packages; made when missing.

    Returns:
        The path of the package.

    Raises:
        UsageError: no built-in scene has that name.
        WorldError: the cache cannot be written.
    """
    path = package_path(name, seed, cache)
    if not path.is_file():
        _require_usd()
        with tempfile.TemporaryDirectory(prefix="scene-") as directory:
            root = author_scene(name, seed, Path(directory))
            scene = _compile(root, name, f"built-in {name}, seed {seed}")
        _write_package(path, encode_scene(scene))
    return path


def import_scene(path: Path, name: str, cache: Path, rules: RuleBook | None = None) -> Path:
    """Compiles a user's USD stage into the cache.

    Args:
        path: the stage's root layer.
        name: what the scene is to be called; lower case, and not the name of a built-in scene.
        cache: directory of packages; made when missing.
        rules: what is called how; the built-in table when `None`.

    Returns:
        The path of the package; its name carries the first digits of its content's SHA-256.

    Raises:
        UsageError: no such file, or a name that cannot be used.
        WorldError: the stage cannot become a scene; the message says why.
    """
    if not _NAME.fullmatch(name):
        raise UsageError(f"{name!r} cannot name a scene; use lower-case letters, digits and _, a letter first")
    if name in BUILTIN_SCENES:
        raise UsageError(f"{name!r} is a built-in scene; give yours another name")
    _require_usd()
    data = encode_scene(_compile(path, name, path.name, rules))
    package = cache / _file_name(name, hashlib.sha256(data).hexdigest())
    _write_package(package, data)
    return package


def _require_usd() -> None:
    missing = [package for package in ("pxr", "mapbox_earcut") if find_spec(package) is None]
    if missing:
        raise UsageError(
            f"USD needs {' and '.join(missing)}; install them with `pip install 'minivla-factory[scenes]'`"
        )


def _compile(path: Path, name: str, source: str, rules: RuleBook | None = None) -> CompiledScene:
    """Loads USD only now: most runs find their scenes in the cache."""
    from factory.scenes.compile import compile_stage

    return compile_stage(path, name, source, rules)


def _write_package(path: Path, data: bytes) -> None:
    """Writes beside, syncs, renames."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, beside = tempfile.mkstemp(prefix=path.name, suffix=".part", dir=path.parent)
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
            Path(beside).chmod(0o644)
            Path(beside).replace(path)
        finally:
            Path(beside).unlink(missing_ok=True)
    except OSError as error:
        raise WorldError(f"cannot write {path} ({error.strerror}); free space or choose another cache") from error
