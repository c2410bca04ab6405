"""`factory scene`: builds, imports, lists, inspects, surveys and renders scenes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

import click
from click.shell_completion import CompletionItem

from factory.cli.groups import CommandGroup
from factory.cli.options import (
    PLACE,
    count_option,
    json_option,
    number_option,
    renderer_option,
    verbose_option,
    write_option,
)
from factory.scenes.limits import MAX_FILE_MB, MAX_TRIANGLES, StageLimits, Unit, UnitName, UpAxis
from schemas.errors import UsageError
from schemas.terms import BUILTIN_CATEGORIES, SuccessMeasure

if TYPE_CHECKING:
    from schemas.storage.place import Place
    from schemas.terms import RendererKind

_UNITS = get_args(UnitName)
_UNIT_RANGE_M = (1e-6, 1e6)


class UnitType(click.ParamType):  # type: ignore[type-arg]  # generic since click 8.5 only
    """Unit of a file: `m`, `cm`, `mm`, `in`, or a number: the length of one unit in metres."""

    name = "unit"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Unit:
        """Returns the name, or the length in metres; other values are a usage error."""
        if isinstance(value, float) or value in _UNITS:
            return value  # type: ignore[no-any-return]  # click gives strings and defaults only
        try:
            metres = float(value)
        except ValueError:
            metres = 0.0
        least, most = _UNIT_RANGE_M
        if not least <= metres <= most:
            self.fail(f"{value!r}: give {', '.join(_UNITS)}, or metres from {least:g} to {most:g}", param, ctx)
        return metres

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:  # noqa: ARG002
        """Completes the names."""
        return [CompletionItem(name) for name in _UNITS if name.startswith(incomplete)]


seed_option = count_option("--seed", 0, "Random seed of the layout of a built-in scene.", least=0)


def complete_scene(context: click.Context, param: click.Parameter, word: str) -> list[CompletionItem]:  # noqa: ARG001
    """Completes the name of a built-in or imported scene, or a file."""
    from factory.runs.scene_packages import find_imported
    from factory.support.settings import scene_cache

    known = [*BUILTIN_CATEGORIES, *find_imported(scene_cache())]
    names = [CompletionItem(name) for name in known if name.startswith(word)]
    return names or [CompletionItem(word, type="file")]


def _complete_file(context: click.Context, param: click.Parameter, word: str) -> list[CompletionItem]:  # noqa: ARG001
    """Completes files of the formats that `factory scene import` reads, with their format, and folders."""
    from factory.scenes.stage_file import SCENE_SUFFIXES, kind_of_file

    folder = word[: word.rfind("/") + 1]
    paths = sorted(Path(folder or ".").iterdir()) if Path(folder or ".").is_dir() else []
    files = [path for path in paths if path.suffix.lower() in SCENE_SUFFIXES and (folder + path.name).startswith(word)]
    items = [CompletionItem(folder + path.name, help=kind_of_file(path)) for path in files]
    return [*items, CompletionItem(word, type="dir")]


file_argument = click.argument("file", type=click.Path(path_type=Path), shell_complete=_complete_file)
"""FILE: a scene of any format that `factory scene import` reads."""

scene_argument = click.argument("scene", metavar="SCENE|PACKAGE", shell_complete=complete_scene)
"""SCENE|PACKAGE: the name of a built-in or imported scene or of a layout (`office_00007`), or a scene package
(`*.scene.zip`)."""


@click.group("scene", cls=CommandGroup)
def command() -> None:
    """Build, import, inspect and render scenes."""


@command.command("list")
@click.argument("place", metavar="[DIR|URL]", type=PLACE, required=False)
@json_option
def list_(place: Place | None, as_json: bool) -> None:
    """List built-in and imported scenes, or those of a dataset.

    DIR|URL is a dataset, whose layouts are listed by family with the seed of each.
    """
    from factory.runs.scene_packages import list_builtin_scenes, list_dataset_scenes, list_imported_scenes
    from factory.support.settings import scene_cache
    from factory.support.terminal import print_json

    if place is not None:
        scenes = list_dataset_scenes(place)
        if as_json:
            print_json(scenes)
        else:
            heads = ("family", "scene", "planned episodes", "splits", "source")
            _print_scenes(heads, scenes, ("family", "name", "planned", "splits", "summary"))
        return
    built_in, imported = list_builtin_scenes(), list_imported_scenes(scene_cache())
    if as_json:
        print_json([*built_in, *imported])
        return
    heads = ("scene", "summary", "seen categories", "held-out categories", "other common categories")
    _print_scenes(heads, built_in, ("name", "summary", "seen", "held_out", "others"))
    if imported:
        click.echo("")
        _print_scenes(("imported", "source", "targets", "package"), imported, ("name", "summary", "targets", "package"))


def _print_scenes(heads: tuple[str, ...], scenes: list[dict[str, Any]], keys: tuple[str, ...]) -> None:
    from factory.support.terminal import print_table

    print_table("", heads, [[scene[key] for key in keys] for scene in scenes])


@command.command("inspect")
@scene_argument
@seed_option
@write_option("FILE", "Also write a map with targets and start points to this PNG file.")
@json_option
def inspect(scene: str, seed: int, out: Path | None, as_json: bool) -> None:
    """Print the categories, targets and extents of a scene.

    SCENE is the name of a scene; PACKAGE is a scene package (*.scene.zip).
    """
    from factory.runs.scene_packages import chosen_scene
    from factory.scenes.inspection import describe_scene, print_scene
    from factory.scenes.topdown import encode_topdown
    from factory.support.terminal import print_result
    from schemas.storage.disk import translated

    compiled = chosen_scene(scene, seed)
    if out is not None:
        with translated("write", out):
            out.write_bytes(encode_topdown(compiled))
    print_result(describe_scene(compiled), as_json, print_scene)


@command.command("light")
@scene_argument
@seed_option
@json_option
def light(scene: str, seed: int, as_json: bool) -> None:
    """Compute the light groups of a scene, and print them.

    SCENE is the name of a scene; PACKAGE is a scene package (*.scene.zip). The groups are kept in the cache; commands
    with --appearance compute them at the first use.
    """
    from factory.dataset.packages import light_file
    from factory.runs.scene_packages import scene_package
    from factory.support.logs import configure_logs
    from factory.support.terminal import print_json, print_table, stderr
    from schemas.appearance.light_groups import decode_light_groups
    from schemas.storage.place import digest_of

    configure_logs()
    package = scene_package(scene, seed)
    with stderr.status(f"light groups of {scene}"):
        path = light_file(package, digest_of(package))
    with path.open("rb") as file:
        groups = decode_light_groups(file).info.groups
    if as_json:
        print_json({"scene": scene, "file": str(path), "groups": [group.model_dump(mode="json") for group in groups]})
        return
    rows = [(group.kind, group.lamps, ", ".join(f"{value:.1f}" for value in group.centre_m)) for group in groups]
    print_table("", ("group", "lamps", "centre x, y, z in metres"), rows)
    click.echo(str(path))


@command.command("render")
@scene_argument
@seed_option
@write_option("DIR", "Output folder of the images. Default: ./SCENE.")
@count_option("--views", 6, "Number of views from 1.5 m above the floor.", least=0, most=64)
@count_option("--robot-views", 4, "Number of views from the robot's camera.", least=0, most=64)
@count_option("--colours", 0, "Number of targets to show with their colour names.", least=0, most=500)
@renderer_option
@json_option
def render(
    scene: str,
    seed: int,
    out: Path | None,
    views: int,
    robot_views: int,
    colours: int,
    renderer: RendererKind,
    as_json: bool,
) -> None:
    """Render the map, views and contact sheets of a scene.

    SCENE is the name of a scene; PACKAGE is a scene package (*.scene.zip).
    """
    from factory.runs.scene_packages import chosen_scene
    from factory.scenes.pictures import Wanted, draw_scene
    from factory.support.logs import configure_logs
    from factory.support.terminal import print_json, stderr
    from schemas.storage.disk import translated

    configure_logs()
    compiled = chosen_scene(scene, seed)
    folder, pictures = out or Path(compiled.info.name), Wanted(views, robot_views, colours)
    with translated("write to", folder), stderr.status(f"rendering {compiled.info.name}"):
        paths = [str(path) for path in draw_scene(compiled, folder, pictures, renderer)]
    if as_json:
        print_json({"scene": compiled.info.name, "pictures": paths})
    else:
        for path in paths:
            click.echo(path)


@command.command("survey")
@click.argument("scene", metavar="[SCENE|PACKAGE]", required=False, shell_complete=complete_scene)
@seed_option
@click.option(
    "--family", metavar="NAME", help="Family whose layouts to compare, instead of one scene. Seeds start at --seed."
)
@count_option("--layouts", 20, "Number of layouts of --family.", least=1, most=10_000)
@number_option(
    "METRES", "--within", 2.0, "Floor within this distance of a start point counts as covered, metres.", least=0.1
)
@click.option(
    "--success",
    type=click.Choice([str(measure) for measure in SuccessMeasure]),
    help="Measure of the distance to the targets. Default: surface if the package has footprints, otherwise centroid.",
)
@json_option
def survey(
    scene: str | None, seed: int, family: str | None, layouts: int, within: float, success: str | None, as_json: bool
) -> int:
    """Measure the start points of a scene, or the diversity of a family.

    SCENE is the name of a scene; PACKAGE is a scene package (*.scene.zip).
    Exits with 1 if there are too few start points or layouts.
    """
    from factory.runs.scene_packages import chosen_scene
    from factory.scenes.survey.spawn_survey import report_survey
    from factory.scenes.survey.text import print_survey, survey_family
    from factory.support.terminal import print_json

    if (scene is None) == (family is None):
        raise click.UsageError("give either SCENE|PACKAGE or --family NAME")
    if scene is None:
        return survey_family(str(family), layouts, seed, as_json)
    compiled = chosen_scene(scene, seed)
    default = SuccessMeasure.SURFACE if compiled.info.has_footprints else SuccessMeasure.CENTROID
    report = report_survey(compiled, within, SuccessMeasure(success or default))
    if as_json:
        print_json(asdict(report))
    else:
        print_survey(report)
    for reason in report.shortcomings:
        click.echo(f"error: {reason}", err=True)
    return 1 if report.shortcomings else 0


@command.command("targets")
@scene_argument
@seed_option
@write_option("FILE", "Output file; - prints to stdout. Default: targets_SCENE.yaml.")
@click.option("--force", is_flag=True, help="Replace an existing file.")
@json_option
def targets(scene: str, seed: int, out: Path | None, force: bool, as_json: bool) -> None:
    """Write the targets of a scene to a YAML file for editing.

    SCENE is the name of a scene; PACKAGE is a scene package (*.scene.zip).
    Pass the edited file to `factory scene build` or `factory scene import` with --targets FILE.
    """
    from factory.runs.scene_packages import chosen_scene
    from factory.scenes.targets.target_list import format_target_list, list_file_name
    from factory.support.terminal import print_json
    from schemas.storage.disk import translated

    info = chosen_scene(scene, seed).info
    path = out or Path(list_file_name(info.name))
    if str(path) == "-":
        if as_json:
            raise UsageError("-o - and --json cannot be combined: remove --json, or give a file with -o")
        click.echo(format_target_list(info), nl=False)
        return
    if path.exists() and not force:
        raise UsageError(f"{path} exists and may contain your edits; replace it with --force")
    with translated("write", path):
        path.write_text(format_target_list(info), encoding="utf-8")
    if as_json:
        print_json({"file": str(path), "scene": info.name, "targets": len(info.targets)})
    else:
        click.echo(str(path))


def _edit_options(verb: Callable[..., None]) -> Callable[..., None]:
    """Adds `--rules --targets --out`: category rules, targets, and the folder of the package."""
    file = click.Path(path_type=Path)
    for option in (
        write_option("DIR", "Output folder of the scene package. Default: the user's cache.", "cache"),
        click.option(
            "--targets",
            type=file,
            metavar="FILE",
            help="List of targets, written by `factory scene targets` and edited. Default: all that the rules find.",
        ),
        click.option(
            "--rules", type=file, metavar="FILE", help="YAML file of category rules. Default: the built-in rules."
        ),
    ):
        verb = option(verb)
    return verb


@command.command("build")
@click.argument("name")
@seed_option
@_edit_options
@json_option
@verbose_option
def build(
    name: str, seed: int, rules: Path | None, targets: Path | None, cache: Path | None, as_json: bool, verbose: bool
) -> None:
    """Build a built-in scene.

    NAME is the name of a built-in scene, see `factory scene list`, or of a layout, such as office_00007. A scene that
    is in the cache is not built again.
    """
    from factory.runs.scene_packages import BuiltInLayout, built_in_layout
    from factory.scenes.build import build_scene, load_edits
    from factory.scenes.inspection import describe_package, print_package
    from factory.support.logs import configure_logs
    from factory.support.settings import scene_cache
    from factory.support.terminal import print_result, stderr

    configure_logs(verbose)
    book, chosen = load_edits(rules, targets, name)
    layout = built_in_layout(name, seed) or BuiltInLayout(name, seed, None)
    with stderr.status(f"building {layout.name}, seed {layout.seed}"):
        path = build_scene(
            layout.name, layout.seed, cache or scene_cache(), rules=book, targets=chosen, called=layout.called
        )
    print_result(describe_package(path), as_json, print_package)


@command.command("import")
@file_argument
@click.option(
    "--name", metavar="NAME", help="Name of the scene. Default: the file name without suffix, in lower case with _."
)
@count_option("--max-triangles", MAX_TRIANGLES, "Maximum number of triangles; a larger scene is an error.")
@count_option("--max-file-mb", MAX_FILE_MB, "Maximum size of one file that is not USD, megabytes.")
@click.option(
    "--unit",
    type=UnitType(),
    metavar="[m|cm|mm|in|METRES]",
    help="Unit of a glTF, OBJ, PLY, STL or COLLADA file; a number is the length of one unit in metres, for "
    "example to rescale a scene that was not drawn in its true size. Default: the unit that the file states.",
)
@click.option(
    "--up",
    type=click.Choice(get_args(UpAxis)),
    help="Axis of a glTF, OBJ, PLY, STL or COLLADA file that points up. Default: the axis that the file states.",
)
@click.option(
    "--model-dir",
    "models",
    multiple=True,
    type=click.Path(path_type=Path),
    metavar="DIR",
    help="Folder in which model:// and package:// names and relative paths are searched; repeatable. After these "
    "folders, the scene's folder and its subfolder models are searched.",
)
@click.option(
    "--skip-missing",
    is_flag=True,
    help="Import a world without its missing models and meshes. Default: an error that names them.",
)
@click.option("--allow-outside", is_flag=True, help="Also read files outside of the scene's folder.")
@click.option(
    "--floor",
    type=click.FloatRange(-1000.0, 1000.0),
    metavar="M",
    help="Height of a flat floor to add to a scene without one, metres. Default: none.",
)
@click.option(
    "--ceiling",
    type=click.FloatRange(1.0, 100.0),
    metavar="M",
    help="Height above the floor of a flat ceiling to add to an open scene, metres. Default: none.",
)
@_edit_options
@json_option
@verbose_option
def import_(
    file: Path,
    name: str | None,
    max_triangles: int,
    max_file_mb: int,
    unit: Unit | None,
    up: UpAxis | None,
    models: tuple[Path, ...],
    skip_missing: bool,
    allow_outside: bool,
    floor: float | None,
    ceiling: float | None,
    rules: Path | None,
    targets: Path | None,
    cache: Path | None,
    as_json: bool,
    verbose: bool,
) -> None:
    """Import a scene file as a scene package.

    FILE is a USD stage (.usd, .usda, .usdc, .usdz), a glTF (.gltf, .glb), OBJ, PLY, STL or COLLADA (.dae) file, an
    SDFormat world or model (.sdf, .world), a URDF file, or an MJCF model (.xml, .mjcf).
    """
    from factory.scenes.build import import_scene, load_edits, name_of_file  # needs usd-core
    from factory.scenes.inspection import describe_package, next_steps, print_others, print_package, print_steps
    from factory.support.logs import configure_logs
    from factory.support.settings import scene_cache
    from factory.support.terminal import print_json, stderr

    configure_logs(verbose)
    called = name or name_of_file(file)
    book, chosen = load_edits(rules, targets, called)
    limits = StageLimits(
        max_triangles=max_triangles,
        allow_outside=allow_outside,
        ceiling_m=ceiling,
        unit=unit,
        up=up,
        models=models,
        max_file_mb=max_file_mb,
        floor_m=floor,
        skip_missing=skip_missing,
    )
    with stderr.status(f"importing {file}"):
        path = import_scene(file, called, cache or scene_cache(), rules=book, targets=chosen, limits=limits)
    if name is None and called != file.stem:
        click.echo(f"note: the scene is named {called}; --name NAME gives it another name", err=True)
    edits = {"rules": rules, "targets": targets}
    used: dict[str, object] = {key: str(edit.resolve()) for key, edit in edits.items() if edit is not None}
    searched = tuple(str(folder.resolve()) for folder in models)
    options = {"allow_outside": allow_outside, "ceiling_m": ceiling, "unit": unit, "up": up, "models": searched}
    options["skip_missing"] = skip_missing
    if floor is not None:
        used["floor_m"] = floor
    used |= {key: value for key, value in options.items() if value}
    facts, steps = describe_package(path), next_steps(path, file, cache is None, used)
    if as_json:
        print_json(facts | asdict(steps))
    else:
        print_package(facts)
        print_others(facts)
        print_steps(steps)
