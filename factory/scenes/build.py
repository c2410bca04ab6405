"""Writes compiled scene packages to the cache: built-in scenes by name and seed, a user's scene by path.

The cache key is the digest of all inputs. Packages are written atomically. Does not compile; see `scenes.compile`.
"""

from __future__ import annotations

import hashlib
import re
import tempfile
import unicodedata
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from factory.scenes.author.scene import AUTHOR_VERSION, BUILTIN_SCENES, PAPER_LAYOUTS, author_content, author_scene
from factory.scenes.cached import mark_as_last, package_name, recall_package, remember_package, write_whole
from factory.scenes.limits import USUAL_LIMITS, StageLimits
from factory.scenes.requirements import require_building
from factory.scenes.rules import RuleBook, builtin_rules, load_rules
from factory.scenes.stage_file import kind_of_file, require_stage
from factory.scenes.targets.target_list import TargetList, load_target_list
from factory.scenes.version import COMPILER_VERSION, IMPORT_VERSION, MATERIALS_VERSION
from schemas.errors import InvalidBundle, LayoutError, UsageError, WorldError
from schemas.scene import LAYOUT_FORMAT, SCENE_FORMAT, CompiledScene, encode_layout, encode_scene
from schemas.scene.compiled import require_valid
from schemas.scene.files import faulty_textures
from schemas.support.suggest import did_you_mean
from schemas.terms import BUILTIN_CATEGORIES, CATEGORIES, PAPER_SCENES, family_of

if TYPE_CHECKING:
    from factory.scenes.importer import Extraction

PAPER_SEED = 0
"""Seed of the four layouts of the paper."""
_LEVEL = 7
"""Compression level of the packages of layouts. Level 9 gives the same size, but takes a third more time."""
_NAME = re.compile(r"[a-z][a-z0-9_]{0,63}")


def package_path(
    name: str,
    seed: int,
    cache: Path,
    rules: RuleBook | None = None,
    targets: TargetList | None = None,
    called: str | None = None,
) -> Path:
    """Returns the cache path of the package of a built-in scene, which may not exist yet; arguments: see `build_scene`.

    Raises:
        UsageError: `name` is not a built-in scene.
    """
    if name not in BUILTIN_SCENES:
        known = f"known: {', '.join(BUILTIN_SCENES)}; use `factory scene import` for a file"
        raise UsageError(f"{name!r} is not a built-in scene; {known}{did_you_mean(name, BUILTIN_SCENES)}")
    book = (rules or rules_of(name)).model_dump_json()
    is_paper = _is_paper(name, seed, called)
    package_format = SCENE_FORMAT if is_paper else LAYOUT_FORMAT
    made_from = f"{name}\n{seed}\n{AUTHOR_VERSION}\n{COMPILER_VERSION}\n{package_format}\n{book}"
    made_from += "" if is_paper else f"\nmaterials {MATERIALS_VERSION}"
    if targets is not None:
        made_from += f"\n{targets.digest}"
    made_from += "" if called is None else f"\n{called}"
    return cache / package_name(called or name, hashlib.sha256(made_from.encode()).hexdigest())


def build_scene(
    name: str,
    seed: int,
    cache: Path,
    rules: RuleBook | None = None,
    targets: TargetList | None = None,
    tell: Callable[[], None] = lambda: None,
    called: str | None = None,
) -> Path:
    """Authors and compiles a built-in scene unless the cache contains its package.

    Seed 0 of a scene of the paper gives the layout of the paper, unless `called` is another name. All other seeds and
    names give layouts of the family.

    Args:
        name: one of `BUILTIN_SCENES`.
        seed: random seed of the layout.
        cache: directory of packages; created if missing.
        rules: category rules; when `None`, those of the built-in table for the categories of the scene.
        targets: edited target list; all targets that the rules find when `None`.
        tell: progress callback, called before a scene is built.
        called: name of the scene in its package, such as `home_00017`; `name` when `None`.

    Returns:
        The path of the package.

    Raises:
        UsageError: `name` is not a built-in scene, or `targets` names prims that the scene does not have.
        LayoutError: the seed has no valid layout, or its layout lacks a category of the scene.
        WorldError: the cache cannot be written.
    """
    path = package_path(name, seed, cache=cache, rules=rules, targets=targets, called=called)
    if not _is_built(path):
        require_building()
        tell()
        try:
            scene = _compile_builtin(name, seed, called=called, rules=rules, targets=targets, cache=cache)
        except WorldError as error:
            raise LayoutError(f"{name}, seed {seed}: {error}") from error
        if _is_paper(name, seed, called):
            write_whole(path, encode_scene(scene))
        else:
            _write_layout(path, scene)
    return path


def _is_built(path: Path) -> bool:
    """Returns whether the cache contains a package and its textures."""
    try:
        return path.is_file() and not faulty_textures(path)
    except InvalidBundle:
        return False


def _write_layout(path: Path, scene: CompiledScene) -> None:
    """Writes the textures that the cache does not have, then the package."""
    layout = encode_layout(scene, _LEVEL)
    for texture, data in layout.textures.items():
        place = path.parent / texture.file
        if not (place.is_file() and place.read_bytes() == data):
            write_whole(place, data)
    write_whole(path, layout.data)


def _compile_builtin(
    name: str, seed: int, called: str | None, rules: RuleBook | None, targets: TargetList | None, cache: Path
) -> CompiledScene:
    """Compiles a layout. The paper's layouts are read from USD files, whose digests their packages record."""
    from factory.scenes.author.drawn import DrawnTextures  # imported here, because most scenes are cached
    from factory.scenes.compile.compiler import compile_extraction, compile_stage
    from factory.scenes.light import LAYOUT_DETAIL

    source, book = f"built-in {name}, seed {seed}", rules or rules_of(name)
    if _is_paper(name, seed, called):
        with tempfile.TemporaryDirectory(prefix="scene-") as directory:
            stage = author_scene(PAPER_LAYOUTS[name], seed, Path(directory))
            # materials would change the bytes of the packages of the paper's layouts
            return compile_stage(stage, name, source=source, rules=book, chosen=targets, has_materials=False)
    required = {category for group in BUILTIN_CATEGORIES[name] for category in group}
    is_usual = rules is None and targets is None
    return compile_extraction(
        name,
        author_content(BUILTIN_SCENES[name], seed),
        name=called or name,
        source=source,
        rules=book,
        chosen=targets,
        detail=LAYOUT_DETAIL,
        required=required if is_usual else (),
        draw=DrawnTextures(cache, AUTHOR_VERSION).pixels,
    )


def _is_paper(name: str, seed: int, called: str | None) -> bool:
    return name in PAPER_LAYOUTS and seed == PAPER_SEED and called in (None, name)


def rules_of(name: str) -> RuleBook:
    """Returns the rules of a built-in scene. Scenes of the paper use the paper's categories, other scenes their own."""
    # with all rules, a category that few layouts of a family have would be a target in these layouts only
    seen, held_out = BUILTIN_CATEGORIES[name]
    return builtin_rules().only(CATEGORIES if name in PAPER_SCENES else {*seen, *held_out})


def import_scene(
    path: Path,
    name: str,
    cache: Path,
    rules: RuleBook | None = None,
    targets: TargetList | None = None,
    limits: StageLimits = USUAL_LIMITS,
    tell: Callable[[], None] = lambda: None,
) -> Path:
    """Compiles a user's scene unless the cache contains a package of the same inputs.

    Args:
        path: root file of the scene.
        name: name of the scene; lower case, different from the built-in scenes.
        cache: directory of packages; created if missing.
        rules: category rules; the built-in table when `None`.
        targets: edited target list; all targets that the rules find when `None`.
        limits: limits of the import.
        tell: progress callback, called before the stage is compiled.

    Returns:
        The path of the package; its name contains the first digits of the SHA-256 of its content.

    Raises:
        UsageError: the file does not exist or has a different format, the name is not valid, or `targets` names
            prims that the scene does not have.
        WorldError: the stage cannot be compiled; the message states the reason.
        InvalidBundle: the compiled scene is not valid; nothing is written.
    """
    require_stage(path)
    _require_name(path, name)
    extraction, made_from = _read_stage(path, rules, targets, limits)
    known = recall_package(cache, name, made_from)
    if known is not None:
        mark_as_last(known)
        return known
    # imported here, because most runs find their scenes in the cache
    from factory.scenes.compile.compiler import compile_extraction
    from factory.scenes.compile.listing import UnreachableTargets
    from factory.scenes.targets.scale import scale_note

    tell()
    scale = scale_note(extraction, kind_of_file(path) not in _WITH_UNIT)
    extraction = replace(extraction, notes=(*extraction.notes, *([scale] if scale else [])))
    try:
        scene = compile_extraction(path.name, extraction, name=name, source=path.name, rules=rules, chosen=targets)
    except UnreachableTargets as error:
        error = UnreachableTargets(f"{error}; {scale}", error.map_png) if scale else error
        picture = cache / f"{name}.map.png"
        write_whole(picture, error.map_png)
        raise WorldError(f"{error}; map of the floor and the objects: {picture}") from error
    require_valid(scene)  # a package that no reader accepts would stay in the cache
    data = encode_scene(scene)
    package = cache / package_name(name, hashlib.sha256(data).hexdigest())
    write_whole(package, data)
    remember_package(cache, name, made_from, package)
    return package


_WITH_UNIT = ("USD", "SDF", "URDF", "MJCF")
"""Formats that define their unit, so --unit is refused."""


def name_of_file(path: Path) -> str:
    """Returns a valid scene name for a file: `My-Room 2.obj` becomes `my_room_2`, and `office.glb` `my_office`."""
    return _valid_name(path.stem)


def _valid_name(text: str) -> str:
    plain = unicodedata.normalize("NFKD", text).encode("ascii", "ignore").decode().lower()
    words = "_".join(re.findall(r"[a-z0-9]+", plain)) or "scene"
    name = words if words[0].isalpha() else f"scene_{words}"
    return f"my_{name}"[:64] if _is_taken(name) else name[:64].rstrip("_")


def _require_name(path: Path, name: str) -> None:
    """Checks the name of an imported scene.

    Raises:
        UsageError: the name is not valid, or belongs to a built-in scene or layout; the message suggests another.
    """
    if not _NAME.fullmatch(name):
        raise UsageError(
            f"{name!r} is not a valid scene name; use lower-case letters, digits and _, starting with a letter: "
            f"--name {_valid_name(name)}"
        )
    if _is_taken(name):
        raise UsageError(f"{name!r} is the name of a built-in scene; choose another one: --name {name_of_file(path)}")


def _is_taken(name: str) -> bool:
    return family_of(name) in BUILTIN_SCENES


def find_import(
    path: Path,
    name: str,
    cache: Path,
    rules: RuleBook | None = None,
    targets: TargetList | None = None,
    limits: StageLimits = USUAL_LIMITS,
) -> Path | None:
    """Returns the cached package of an import, or `None` if it must be compiled. Arguments as for `import_scene`."""
    if not any(cache.glob(f"{name}-*.scene.zip")):
        return None
    # compares digests, because times of files do not show that a file exists which was missing before
    _, made_from = _read_stage(path, rules, targets, limits)
    return recall_package(cache, name, made_from)


def _read_stage(
    path: Path, rules: RuleBook | None, targets: TargetList | None, limits: StageLimits
) -> tuple[Extraction, str]:
    """Returns the extracted stage, and the SHA-256 of all inputs of its package."""
    require_building()
    from factory.scenes.formats import extract_scene

    extraction = extract_scene(path, limits)
    book = (rules or builtin_rules()).model_dump_json()
    parts = (path.name, extraction.files_sha256, *extraction.notes, book, targets and targets.digest)
    made_from = "\n".join(map(str, (IMPORT_VERSION, COMPILER_VERSION, SCENE_FORMAT, MATERIALS_VERSION, *parts)))
    return extraction, hashlib.sha256(made_from.encode()).hexdigest()


def load_edits(
    rules: Path | None, targets: Path | None, scene: str = "SCENE"
) -> tuple[RuleBook | None, TargetList | None]:
    """Reads the user's category rules and edited target list.

    Args:
        rules: path of the rules, if given.
        targets: path of the target list, if given.
        scene: name of the scene, used in the command that an error message suggests.

    Raises:
        UsageError: a file does not exist or is not valid.
    """
    book = None if rules is None else load_rules(rules)
    return book, None if targets is None else load_target_list(targets, scene)
