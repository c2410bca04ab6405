"""`factory export`: converts a dataset to a training format. The options of a format are the fields of its model."""

from __future__ import annotations

import types
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args, get_origin

import click
from pydantic import ValidationError
from pydantic.fields import FieldInfo

from coordinator.defaults import usable_cores
from factory.cli.options import (
    json_option,
    place_argument,
    rig_option,
    split_filter,
    workers_option,
    write_option,
)
from factory.export.options import OPTIONS, Options
from factory.export.registry import EXPORTERS, check_format, find_exporter
from schemas.errors import UsageError

if TYPE_CHECKING:
    from schemas.storage.place import Place

Command = Callable[..., Any]


def format_options(command: Command) -> Command:
    """Adds one option for each field of each format's option model; the value is `None` if the option is not given."""
    for name, (info, formats) in reversed(_fields().items()):
        command = _option(name, info, formats)(command)
    return command


def _fields() -> dict[str, tuple[FieldInfo, list[str]]]:
    fields: dict[str, tuple[FieldInfo, list[str]]] = {}
    for format_name, options in OPTIONS.items():
        for name, info in options.model_fields.items():
            fields.setdefault(name, (info, []))[1].append(format_name)
    return fields


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
    """The name of an export format; the error of an unknown one suggests the closest."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Returns the name, or raises `UsageError`."""
        check_format(str(value))
        return super().convert(value, param, ctx)


@click.command("export")
@place_argument
@click.option(
    "--to",
    "format_name",
    required=True,
    type=FormatName(list(EXPORTERS)),
    metavar="FORMAT",
    help=f"Format of the export. Values: {', '.join(EXPORTERS)}.",
)
@write_option("DIR", "Output directory. An interrupted export with the same options is continued.", required=True)
@split_filter()
@click.option(
    "--episode", "episodes", metavar="IDS", help="Episodes to include, e.g. 1-50,60 or ep_000060. Default: all."
)
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
def command(
    root: Place,
    format_name: str,
    out: Path,
    splits: tuple[str, ...] | None,
    episodes: str | None,
    exclude: Path | None,
    rig: str | None,
    workers: int | None,
    dry_run: bool,
    as_json: bool,
    **format_values: Any,
) -> int:
    """Convert a dataset to another format.

    After Ctrl-C, a crash or a full disk, the same command continues the export. An option whose help ends with format
    names in brackets is valid for these formats only. RIG is a built-in rig or a TOML file, see `factory rig list`;
    its sensors are rendered from the recorded poses. Exits with 1 if episodes are missing or were skipped.
    """
    from factory.dataset.marks import excluded_in
    from factory.export.execution.estimate import estimate_export
    from factory.export.execution.export_run import ExportOrder, run_export
    from factory.export.execution.report_text import (
        ExportBar,
        print_estimate,
        print_omitted,
        print_render_hint,
        print_report,
    )
    from factory.export.execution.selection import parse_episodes
    from factory.support.logs import configure_logs
    from factory.support.terminal import print_result, stderr
    from workers.client.stopping import stop_on_signals

    configure_logs()
    order = ExportOrder(
        root=root,
        out=out,
        format=format_name,
        options=_options(format_name, format_values),
        splits=splits or (),
        episodes=tuple(parse_episodes(episodes)) if episodes else (),
        excluded=tuple(excluded_in(exclude)) if exclude else (),
        workers=workers or usable_cores(),
        rig=rig,
    )
    if dry_run:
        with stderr.status("measuring one episode"):
            estimate = estimate_export(order)
        print_result(estimate, as_json, print_estimate)
        return 0 if estimate.fits else 1
    with stop_on_signals() as (stop, _), ExportBar(format_name) as bar:
        report = run_export(order, bar.show, stop)
    print_omitted(report)
    if not report.finished:
        click.echo(f"interrupted after {report.episodes} episodes; run the same command again to continue", err=True)
        return 130
    print_result(report, as_json, print_report)
    print_render_hint(report)
    return 0 if report.complete and not report.absent else 1


def _options(name: str, values: dict[str, Any]) -> Options:
    """Returns the options of a format; a value of `None` was not given."""
    given = {key: value for key, value in values.items() if value is not None}
    model: type[Options] = find_exporter(name).options
    surplus = [f"--{key.replace('_', '-')}" for key in given if key not in model.model_fields]
    if surplus:
        known = ", ".join(f"--{key.replace('_', '-')}" for key in model.model_fields) or "none"
        raise UsageError(f"{', '.join(surplus)} not valid for format {name}; valid format options: {known}")
    try:
        return model.model_validate(given)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"])).replace("_", "-")
        raise UsageError(f"--{where}: {first['msg']}") from error
