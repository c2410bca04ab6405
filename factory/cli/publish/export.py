"""Declares `factory export`. The options of a format are the fields of its model."""

from __future__ import annotations

import types
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

import click
from pydantic.fields import FieldInfo

from factory.cli.common.filters import split_filter
from factory.cli.common.options import (
    former_option,
    json_option,
    place_argument,
    rig_option,
    workers_option,
    write_option,
)
from factory.export.options import OPTIONS
from factory.export.registry import EXPORTERS, check_format

Command = Callable[..., Any]


def format_options(command: Command) -> Command:
    """Adds one option for each field of each format's option model; the value is `None` if the option is not given."""
    for name, (info, formats) in reversed(_fields().items()):
        command = _option(name, info, formats)(command)
    return command


def _fields() -> dict[str, tuple[FieldInfo, list[str]]]:
    found: dict[str, tuple[FieldInfo, list[str]]] = {}
    for format_name, options in OPTIONS.items():
        for name, info in options.model_fields.items():
            found.setdefault(name, (info, []))[1].append(format_name)
    return found


def _option(name: str, info: FieldInfo, formats: list[str]) -> Callable[[Command], Command]:
    flag = f"--{name.replace('_', '-')}"
    text = f"{info.description} [{', '.join(formats)}]"
    kind = _without_none(info.annotation)
    if kind is bool:
        return click.option(f"{flag}/--no-{flag[2:]}", name, default=None, help=text)
    if get_origin(kind) is Literal:
        return click.option(flag, name, type=click.Choice([str(value) for value in get_args(kind)]), help=text)
    if kind in (int, float, str):
        return click.option(flag, name, type=kind, metavar="N" if kind is int else None, help=text)
    raise TypeError(f"option {flag}: type {kind} is not supported on the command line")


def _without_none(annotation: Any) -> Any:
    if get_origin(annotation) is types.UnionType:
        return next(kind for kind in get_args(annotation) if kind is not type(None))
    return annotation


class FormatName(click.Choice):  # type: ignore[type-arg]  # generic since click 8.2 only
    """The name of an export format; for a format that another tool writes, the error names that tool."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Returns the name, or raises `UsageError`."""
        check_format(str(value))
        return super().convert(value, param, ctx)


@click.command("export")
@place_argument
@click.option("--to", "format_name", required=True, type=FormatName(list(EXPORTERS)), help="Format of the export.")
@write_option("DIR", "Output directory. An interrupted export with the same options is continued.", required=True)
@split_filter()
@click.option(
    "--episode", "episodes", metavar="IDS", help="Episodes to include, e.g. 1-50,60 or ep_000060. Default: all."
)
@former_option("--episodes", "episodes", "--episode")
@click.option(
    "--exclude",
    type=click.Path(path_type=Path, dir_okay=False),
    metavar="FILE",
    help="Omit the flagged episodes of marks.json (see `factory serve`), or the ids in a text file, one on each "
    "line. Default: none.",
)
@rig_option("Export the sensors of a rig. Default: the recorded camera.")
@workers_option("Number of processes")
@click.option("--dry-run", is_flag=True, help="Estimate size and time from one episode; write no files.")
@format_options
@json_option
def command(**options: Any) -> int:
    """Convert a dataset to another format.

    After Ctrl-C, a crash or a full disk, the same command continues the export. An option whose help ends with format
    names in brackets is valid for these formats only. RIG is a built-in rig or a TOML file, see `factory rig list`;
    its sensors are rendered from the recorded poses. Exits with 1 if episodes are missing or were skipped.
    """
    from factory.commands.publish.export import execute

    return execute(**options)
