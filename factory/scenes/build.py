"""Makes compiled scene packages on disk: the built-in scenes by name and seed, a user's USD by path.

Caches packages by what they are made from; a package appears whole or not at all.
"""

from __future__ import annotations

import hashlib
import re
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from factory.scenes.author import AUTHOR_VERSION, BUILTIN_SCENES, author_scene
from factory.scenes.cached import mark_as_last, package_name, recall_package, remember_package, write_whole
from factory.scenes.limits import USUAL_LIMITS, StageLimits
from factory.scenes.rules import RuleBook, load_rules
from factory.scenes.stage_file import require_stage
from factory.scenes.targets.target_list import TargetList, load_target_list
from factory.scenes.version import COMPILER_VERSION
from schemas.errors import UsageError
from schemas.scene import SCENE_FORMAT, encode_scene
from schemas.support.extras import require_package
from schemas.support.suggest import did_you_mean

if TYPE_CHECKING:
    from factory.scenes.importer import Extraction

__all__ = ["build_scene", "find_import", "import_scene", "load_edits", "package_path"]

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
    return cache / package_name(name, hashlib.sha256(made_from.encode()).hexdigest())


def build_scene(
    name: str,
    seed: int,
    cache: Path,
    rules: RuleBook | None = None,
    targets: TargetList | None = None,
    tell: Callable[[], None] = lambda: None,
) -> Path:
    """Authors and compiles a built-in scene unless the cache has it already.

    Args:
        name: one of `BUILTIN_SCENES`.
        seed: of the layout.
        cache: directory of packages; made when missing.
        rules: what is called how; the built-in table when `None`.
        targets: an edited list of targets; all that the rules find when `None`.
        tell: called before something is built.

    Returns:
        The path of the package.

    Raises:
        UsageError: no built-in scene has that name, or the list names prims that it lacks.
        WorldError: the cache cannot be written.
    """
    path = package_path(name, seed, cache, rules, targets)
    if not path.is_file():
        _require_usd()
        from factory.scenes.compile.compiler import compile_stage  # only now: most runs find their scenes in the cache

        tell()
        with tempfile.TemporaryDirectory(prefix="scene-") as directory:
            root = author_scene(name, seed, Path(directory))
            scene = compile_stage(root, name, f"built-in {name}, seed {seed}", rules, targets)
        write_whole(path, encode_scene(scene))
    return path


def import_scene(
    path: Path,
    name: str,
    cache: Path,
    rules: RuleBook | None = None,
    targets: TargetList | None = None,
    limits: StageLimits = USUAL_LIMITS,
    tell: Callable[[], None] = lambda: None,
) -> Path:
    """Compiles a user's USD stage into the cache, unless it was compiled from the same before.

    Args:
        path: the stage's root layer.
        name: what the scene is to be called; lower case, and not the name of a built-in scene.
        cache: directory of packages; made when missing.
        rules: what is called how; the built-in table when `None`.
        targets: an edited list of targets; all that the rules find when `None`.
        limits: what is refused.
        tell: called before something is compiled.

    Returns:
        The path of the package; its name carries the first digits of its content's SHA-256.

    Raises:
        UsageError: no such file, another format than USD, a name that cannot be used, or a list that names prims the
            stage lacks.
        WorldError: the stage cannot become a scene; the message says why.
    """
    require_stage(path)
    if not _NAME.fullmatch(name):
        raise UsageError(f"{name!r} cannot name a scene; use lower-case letters, digits and _, a letter first")
    if name in BUILTIN_SCENES:
        raise UsageError(f"{name!r} is a built-in scene; give yours another name")
    extraction, made_from = _read_stage(path, rules, targets, limits)
    known = recall_package(cache, name, made_from)
    if known is not None:
        mark_as_last(known)
        return known
    from factory.scenes.compile.compiler import compile_extraction  # only now: most runs find their scenes in the cache

    tell()
    data = encode_scene(compile_extraction(path.name, extraction, name, path.name, rules, targets))
    package = cache / package_name(name, hashlib.sha256(data).hexdigest())
    write_whole(package, data)
    remember_package(cache, name, made_from, package)
    return package


def find_import(
    path: Path,
    name: str,
    cache: Path,
    rules: RuleBook | None = None,
    targets: TargetList | None = None,
    limits: StageLimits = USUAL_LIMITS,
) -> Path | None:
    """Returns the package that `import_scene` would return without compiling, or `None`; arguments as there."""
    if not any(cache.glob(f"{name}-*.scene.zip")):
        return None
    _, made_from = _read_stage(path, rules, targets, limits)
    return recall_package(cache, name, made_from)


def _read_stage(
    path: Path, rules: RuleBook | None, targets: TargetList | None, limits: StageLimits
) -> tuple[Extraction, str]:
    """Returns what a stage shows, and the SHA-256 of all that makes a package of it what it is."""
    _require_usd()
    from factory.scenes.importer import extract_stage

    extraction = extract_stage(path, limits)
    book = (rules or load_rules()).model_dump_json()
    parts = (path.name, extraction.files_sha256, *extraction.notes, book, targets and targets.digest)
    made_from = "\n".join(map(str, (COMPILER_VERSION, SCENE_FORMAT, *parts)))
    return extraction, hashlib.sha256(made_from.encode()).hexdigest()


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
    for module in ("pxr", "mapbox_earcut", "embreex"):
        require_package(module, "building a scene from USD")
