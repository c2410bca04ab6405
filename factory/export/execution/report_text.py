"""Prints an export: its progress bar, its report and the estimate of its size and time. Computes nothing."""

from __future__ import annotations

import click

from factory.export.execution.estimate import ExportEstimate
from factory.export.execution.export_run import ExportProgress
from factory.export.execution.manifest import ExportReport
from factory.export.questions import questions_words
from factory.support.terminal import Bars
from factory.support.text import format_duration
from schemas.support.shell import quoted

_NAMED = 5
_LONG_S = 10
"""Time of an export after which the hint to store the frames is printed, seconds."""


class ExportBar(Bars):
    """Progress bar of an export: episodes, frames per second, current stage."""

    def __init__(self, name: str) -> None:
        super().__init__(transient=True)
        self._task = self.add_task(name, total=None)

    def show(self, progress: ExportProgress) -> None:
        """Updates the bar."""
        elapsed = self.tasks[0].elapsed or 0.0
        rate = f"{progress.frames / elapsed:.0f} frames/s" if progress.frames and elapsed else ""
        note = rate if progress.stage == "episodes" else progress.stage
        self.update(self._task, completed=progress.done, total=progress.total, note=note)


def print_omitted(report: ExportReport) -> None:
    """Prints on stderr which episodes were skipped, not selected or missing, and the rig that was not exported."""
    if report.unselected:
        click.echo(
            f"not exported, because --split does not select their splits: {_named(report.unselected)}; "
            "omit --split to export all episodes of --episode",
            err=True,
        )
    if report.rig_left_out is not None:
        click.echo(
            f"the frames are those of the recorded camera; to export the sensors of the dataset's rig, add --rig "
            f"{quoted(report.rig_left_out)}",
            err=True,
        )
    for question in () if report.questions is None else report.questions.omitted[:_NAMED]:
        click.echo(f"question {question.id} is not in the export: {question.reason}", err=True)
    unnamed = 0 if report.questions is None else len(report.questions.omitted) - _NAMED
    if unnamed > 0:
        click.echo(f"{unnamed} more questions are not in the export; export.json lists them", err=True)
    for skip in report.skipped:
        click.echo(f"skipped {skip.episode_id}: {skip.reason}", err=True)
    if report.absent:
        click.echo(
            f"missing in the dataset: {_named(report.absent)}; to export them, finish the run and export to "
            "another --out",
            err=True,
        )


def _named(episodes: tuple[str, ...]) -> str:
    named, more = ", ".join(episodes[:_NAMED]), len(episodes) - _NAMED
    return f"{named} and {more} more" if more > 0 else named


def print_report(report: ExportReport) -> None:
    """Prints the report of an export."""
    resumed = f" ({report.resumed} exported earlier)" if report.resumed else ""
    speed = f", {report.frames_per_second:.0f} frames/s" if report.frames_per_second else ""
    what = f"{report.episodes} episodes{resumed}, {report.frames} frames, {_megabytes(report.bytes)}"
    asked = "" if report.questions is None else f", {questions_words(report.questions)}"
    lacking = {"skipped": len(report.skipped), "missing in the dataset": len(report.absent)}
    state = ", ".join(f"{count} episodes {what}" for what, count in lacking.items() if count) or "complete"
    click.echo(f"{report.out}: {report.format}, {what}, {format_duration(report.seconds)}{speed}{asked}; {state}")


def print_render_hint(report: ExportReport) -> None:
    """Prints on stderr how to render the frames once for several exports, if this export has rendered for a while."""
    if report.render_command is not None and report.seconds >= _LONG_S:
        click.echo(
            "the dataset stores states, so each export renders its frames again; for further exports, store them once "
            f"and export the result: {report.render_command}",
            err=True,
        )


def print_estimate(estimate: ExportEstimate) -> None:
    """Prints an estimate."""
    click.echo(f"{estimate.format}: {estimate.episodes} episodes, {estimate.frames} frames")
    click.echo(f"size: about {_megabytes(estimate.bytes)}, during the export {_megabytes(estimate.peak_bytes)}")
    click.echo(f"time: about {format_duration(estimate.seconds)} with {estimate.workers} processes")
    sample = f"{estimate.sample_frames} frames, {_megabytes(estimate.sample_bytes)}, {estimate.sample_seconds:.1f} s"
    click.echo(f"measured with {estimate.sample}: {sample}")
    fits = "enough" if estimate.fits else "NOT enough: free some space, or choose another --out"
    click.echo(f"free space: {_megabytes(estimate.free_bytes)}, {fits}")


def _megabytes(size: int) -> str:
    return f"{size / 1e9:.2f} GB" if size >= 1e9 else f"{size / 1e6:.1f} MB"
