"""Declares `factory scene` with its commands `build` and `import`; the other commands have their own modules."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, get_args

import click

from factory.cli.common.groups import CommandGroup
from factory.cli.common.options import count_option, former_option, json_option, verbose_option, write_option
from factory.cli.scene import inspect as scene_inspect
from factory.cli.scene import light as scene_light
from factory.cli.scene import list as scene_list
from factory.cli.scene import render as scene_render
from factory.cli.scene import survey as scene_survey
from factory.cli.scene import targets as scene_targets
from factory.cli.scene.choice import UnitType, file_argument, seed_option
from factory.scenes.limits import MAX_FILE_MB, MAX_TRIANGLES, UpAxis


@click.group("scene", cls=CommandGroup)
def command() -> None:
    """Build, import, inspect and render scenes."""


command.add_command(scene_list.command)
command.add_command(scene_inspect.command)
command.add_command(scene_light.command)
command.add_command(scene_render.command)
command.add_command(scene_survey.command)
command.add_command(scene_targets.command)


def _edit_options(verb: Callable[..., None]) -> Callable[..., None]:
    """Adds `--rules --targets --out`: category rules, targets, and the folder of the package."""
    file = click.Path(path_type=Path)
    for option in (
        former_option("--cache", "cache", "--out", type=file),
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
def build(**options: Any) -> None:
    """Build a built-in scene.

    NAME is the name of a built-in scene, see `factory scene list`, or of a layout, such as office_00007. A scene that
    is in the cache is not built again.
    """
    from factory.commands.scene.command import build

    build(**options)


@command.command("import")
@file_argument
@click.option("--name", metavar="NAME", help="Name of the scene. Default: the file name without suffix.")
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
def import_(**options: Any) -> None:
    """Import a scene file as a scene package.

    FILE is a USD stage (.usd, .usda, .usdc, .usdz), a glTF (.gltf, .glb), OBJ, PLY, STL or COLLADA (.dae) file, an
    SDFormat world or model (.sdf, .world), a URDF file, or an MJCF model (.xml, .mjcf).
    """
    from factory.commands.scene.command import import_

    import_(**options)
