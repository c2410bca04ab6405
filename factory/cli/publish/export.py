"""`factory export`: converts a dataset to a training format. The options of a format are the fields of its model."""

from __future__ import annotations

import os
import types
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

import click
from pydantic import ValidationError
from pydantic.fields import FieldInfo

from factory.cli.common.bars import Bars
from factory.cli.common.filters import split_filter
from factory.cli.common.options import former_option, place_argument, rig_option, workers_option, write_option
from factory.cli.common.output import json_option, print_result, stderr
from factory.dataset.marks import excluded_in
from factory.export.base import Options
from factory.export.execution.estimate import ExportEstimate, estimate_export
from factory.export.execution.report import ExportReport
from factory.export.execution.run import ExportOrder, ExportProgress, run_export
from factory.export.execution.selection import parse_episodes
from factory.export.registry import EXPORTERS, check_format, find_exporter
from factory.support.logs import configure_logs
from factory.support.text import format_duration
from schemas.errors import UsageError
from schemas.storage.place import Place
from workers.client.stopping import stop_on_signals

Command = Callable[..., Any]
_NAMED = 5


def format_options(command: Command) -> Command:
    """Adds one option for each field of each format's option model; the value is `None` if the option is not given."""
    for name, (info, formats) in reversed(_fields().items()):
        command = _option(name, info, formats)(command)
    return command


def _fields() -> dict[str, tuple[FieldInfo, list[str]]]:
    found: dict[str, tuple[FieldInfo, list[str]]] = {}
    for exporter in map(find_exporter, EXPORTERS):
        for name, info in exporter.options.model_fields.items():
            found.setdefault(name, (info, []))[1].append(exporter.name)
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
    **chosen: Any,
) -> int:
    """Convert a dataset to another format.

    After Ctrl-C, a crash or a full disk, the same command continues the export. An option whose help ends with format
    names in brackets is valid for these formats only. RIG is a built-in rig or a TOML file, see `factory rig list`;
    its sensors are rendered from the recorded poses. Exits with 1 if episodes are missing or were skipped.
    """
    configure_logs()
    order = ExportOrder(
        root=root,
        out=out,
        format=format_name,
        options=_options(format_name, chosen),
        splits=splits or (),
        episodes=tuple(parse_episodes(episodes)) if episodes else (),
        excluded=tuple(excluded_in(exclude)) if exclude else (),
        workers=workers or os.cpu_count() or 1,
        rig=rig,
    )
    if dry_run:
        return _estimate(order, as_json)
    with stop_on_signals() as (stop, _), _ExportBar(format_name) as bar:
        report = run_export(order, bar.tell, stop)
    for skip in report.skipped:
        click.echo(f"skipped {skip.episode_id}: {skip.reason}", err=True)
    if report.absent:
        named, more = ", ".join(report.absent[:_NAMED]), len(report.absent) - _NAMED
        names = f"{named} and {more} more" if more > 0 else named
        click.echo(
            f"missing in the dataset: {names}; to export them, finish the run and export to another --out", err=True
        )
    if not report.finished:
        click.echo(f"interrupted after {report.episodes} episodes; run the same command again to continue", err=True)
        return 130
    print_result(report, as_json, _print)
    return 0 if report.complete and not report.absent else 1


def _options(name: str, chosen: dict[str, Any]) -> Options:
    given = {key: value for key, value in chosen.items() if value is not None}
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


def _estimate(order: ExportOrder, as_json: bool) -> int:
    with stderr.status("measuring one episode"):
        estimate = estimate_export(order)
    print_result(estimate, as_json, _print_estimate)
    return 0 if estimate.fits else 1


def _print_estimate(estimate: ExportEstimate) -> None:
    click.echo(f"{estimate.format}: {estimate.episodes} episodes, {estimate.frames} frames")
    click.echo(f"size: about {_megabytes(estimate.bytes)}, during the export {_megabytes(estimate.peak_bytes)}")
    click.echo(f"time: about {format_duration(estimate.seconds)} with {estimate.workers} processes")
    sample = f"{estimate.sample_frames} frames, {_megabytes(estimate.sample_bytes)}, {estimate.sample_seconds:.1f} s"
    click.echo(f"measured with {estimate.sample}: {sample}")
    fits = "enough" if estimate.fits else "NOT enough: free some space, or choose another --out"
    click.echo(f"free space: {_megabytes(estimate.free_bytes)}, {fits}")


def _print(report: ExportReport) -> None:
    resumed = f" ({report.resumed} exported earlier)" if report.resumed else ""
    speed = f", {report.frames_per_second:.0f} frames/s" if report.frames_per_second else ""
    what = f"{report.episodes} episodes{resumed}, {report.frames} frames, {_megabytes(report.bytes)}"
    lacking = {"skipped": len(report.skipped), "missing in the dataset": len(report.absent)}
    state = ", ".join(f"{count} episodes {what}" for what, count in lacking.items() if count) or "complete"
    click.echo(f"{report.out}: {report.format}, {what}, {format_duration(report.seconds)}{speed}; {state}")


def _megabytes(size: int) -> str:
    return f"{size / 1e9:.2f} GB" if size >= 1e9 else f"{size / 1e6:.1f} MB"


class _ExportBar(Bars):
    """Progress bar of an export: episodes, frames per second, current stage."""

    def __init__(self, name: str) -> None:
        super().__init__(transient=True)
        self._task = self.add_task(name, total=None)

    def tell(self, progress: ExportProgress) -> None:
        """Updates the bar."""
        elapsed = self.tasks[0].elapsed or 0.0
        rate = f"{progress.frames / elapsed:.0f} frames/s" if progress.frames and elapsed else ""
        note = rate if progress.stage == "episodes" else progress.stage
        self.update(self._task, completed=progress.done, total=progress.total, note=note)
