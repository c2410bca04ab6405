"""`factory export`: converts a dataset to a training format. The options of a format are the fields of its model."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import click
from pydantic import ValidationError

from factory.commands.common.bars import Bars
from factory.commands.common.output import print_result, stderr
from factory.dataset.marks import excluded_in
from factory.export.execution.estimate import ExportEstimate, estimate_export
from factory.export.execution.export_run import ExportOrder, ExportProgress, run_export
from factory.export.execution.manifest import ExportReport
from factory.export.execution.selection import parse_episodes
from factory.export.options import Options
from factory.export.registry import find_exporter
from factory.support.logs import configure_logs
from factory.support.text import format_duration
from schemas.errors import UsageError
from schemas.storage.place import Place
from workers.client.stopping import stop_on_signals

_NAMED = 5


def execute(
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
    """Executes `factory export`."""
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
