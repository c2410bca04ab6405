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
from factory.scenes.limits import USUAL_LIMITS, StageLimits
from factory.scenes.rules import RuleBook, load_rules
from factory.scenes.target_list import TargetList, load_target_list
from factory.scenes.version import COMPILER_VERSION
from schemas.errors import UsageError, WorldError
from schemas.meant import did_you_mean
from schemas.scene import SCENE_FORMAT, CompiledScene, encode_scene

__all__ = ["build_scene", "import_scene", "load_edits", "package_path"]

_NAME = re.compile(r"[a-z][a-z0-9_]{0,63}")


def package_path(
    name: str, seed: int, cache: Path, rules: RuleBook | None = None, targets: TargetList | None = None
) -> Path:
    """Returns where the package of a built-in scene lies in a cache, whether it is there yet or not.

    Raises:
        UsageError: no built-in scene has that name.
    """
    if name not in BUILTIN_SCENES:
        known = f"known: {', '.join(BUILTIN_SCENES)}; use `factory scene import` for a USD"
        raise UsageError(f"no built-in scene is called {name!r}; {known}{did_you_mean(name, BUILTIN_SCENES)}")
    book = (rules or load_rules()).model_dump_json()
    made_from = f"{name}\n{seed}\n{AUTHOR_VERSION}\n{COMPILER_VERSION}\n{SCENE_FORMAT}\n{book}"
    if targets is not None:
        made_from += f"\n{targets.digest}"
    return cache / _file_name(name, hashlib.sha256(made_from.encode()).hexdigest())


def _file_name(name: str, digest: str) -> str:
    return f"{name}-{digest[:12]}.scene.zip"


def build_scene(
    name: str, seed: int, cache: Path, rules: RuleBook | None = None, targets: TargetList | None = None
) -> Path:
    """Authors and compiles a built-in scene unless the cache has it already.

    Args:
        name: one of `BUILTIN_SCENES`.
        seed: of the layout.
        cache: directory of packages; made when missing.
        rules: what is called how; the built-in table when `None`.
        targets: an edited list of targets; all that the rules find when `None`.

    Returns:
        The path of the package.

    Raises:
        UsageError: no built-in scene has that name, or the list names prims that it lacks.
        WorldError: the cache cannot be written.
    """
    path = package_path(name, seed, cache, rules, targets)
    if not path.is_file():
        _require_usd()
        with tempfile.TemporaryDirectory(prefix="scene-") as directory:
            root = author_scene(name, seed, Path(directory))
            scene = _compile(root, name, f"built-in {name}, seed {seed}", rules, targets)
        _write_package(path, encode_scene(scene))
    return path


def import_scene(
    path: Path,
    name: str,
    cache: Path,
    rules: RuleBook | None = None,
    targets: TargetList | None = None,
    limits: StageLimits = USUAL_LIMITS,
) -> Path:
    """Compiles a user's USD stage into the cache.

    Args:
        path: the stage's root layer.
        name: what the scene is to be called; lower case, and not the name of a built-in scene.
        cache: directory of packages; made when missing.
        rules: what is called how; the built-in table when `None`.
        targets: an edited list of targets; all that the rules find when `None`.
        limits: what is refused.

    Returns:
        The path of the package; its name carries the first digits of its content's SHA-256.

    Raises:
        UsageError: no such file, a name that cannot be used, or a list that names prims the stage lacks.
        WorldError: the stage cannot become a scene; the message says why.
    """
    if not _NAME.fullmatch(name):
        raise UsageError(f"{name!r} cannot name a scene; use lower-case letters, digits and _, a letter first")
    if name in BUILTIN_SCENES:
        raise UsageError(f"{name!r} is a built-in scene; give yours another name")
    _require_usd()
    data = encode_scene(_compile(path, name, path.name, rules, targets, limits))
    package = cache / _file_name(name, hashlib.sha256(data).hexdigest())
    _write_package(package, data)
    return package


def load_edits(
    rules: Path | None, targets: Path | None, scene: str = "SCENE"
) -> tuple[RuleBook | None, TargetList | None]:
    """Reads a user's own table of rules and edited list of targets, where given.

    Args:
        rules: the table, if any.
        targets: the list, if any.
        scene: what the scene is called, for the command that writes such a list.

    Raises:
        UsageError: a file is not there or makes no sense.
    """
    book = None if rules is None else load_rules(rules)
    return book, None if targets is None else load_target_list(targets, scene)


def _require_usd() -> None:
    missing = [package for package in ("pxr", "mapbox_earcut", "embreex") if find_spec(package) is None]
    if missing:
        raise UsageError(
            f"USD needs {' and '.join(missing)}; install them with `pip install 'minivla-factory[scenes]'`"
        )


def _compile(
    path: Path,
    name: str,
    source: str,
    rules: RuleBook | None,
    targets: TargetList | None,
    limits: StageLimits = USUAL_LIMITS,
) -> CompiledScene:
    """Loads USD only now: most runs find their scenes in the cache."""
    from factory.scenes.compile import compile_stage

    return compile_stage(path, name, source, rules, targets, limits)


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
