"""Shows a run: its progress bar, and its summary when it has finished: episodes, location and next command."""

from __future__ import annotations

from typing import Any

import click
import pyarrow.compute as pc
from rich.console import Console

from factory.dataset.reader import Dataset
from factory.support.terminal import Bars, print_table, print_text, stderr
from factory.support.text import format_duration
from schemas.plan import Plan
from schemas.protocol.status import Progress
from schemas.storage.place import Place
from schemas.support.shell import quoted
from schemas.terms import FailReason

_WORDS = {str(FailReason.RELEASED): "returned"}
"""Names of outcomes in the summary, where they differ from the outcome's value."""


class RunBar(Bars):
    """Progress bar of a run: episodes, rate, time left, running jobs and failed attempts.

    Nothing is shown before the first progress is known, so a run that cannot start shows no count.
    """

    def __init__(self, plan: Plan, console: Console = stderr) -> None:
        super().__init__(console=console)
        self._task = self.add_task(plan.name, total=None, visible=False)

    def show(self, progress: Progress) -> None:
        """Updates the bar."""
        failures = sum(progress.failures.values())
        rate = "" if progress.episodes_per_hour is None else f"{progress.episodes_per_hour:.0f} episodes/h, "
        left = "" if progress.eta_s is None else f"{format_duration(progress.eta_s)} left, "
        layouts = f", {progress.built_layouts}" if progress.layouts else ""
        done = progress.jobs.get("archived", 0)
        reason = max(progress.failures, key=progress.failures.__getitem__) if failures > done else ""
        most = f" (most: {reason} {progress.failures[reason]})" if reason else ""
        note = f"{rate}{left}{progress.jobs.get('leased', 0)} running, {failures} failed attempts{most}{layouts}"
        self.update(self._task, total=progress.planned, completed=done, note=note, visible=True)


def summarise(root: Place, progress: Progress) -> dict[str, Any]:
    """Returns the summary of a finished run as JSON data."""
    dataset = Dataset(root)
    return {
        "dataset": str(root),
        "run": progress.run,
        "episodes": len(dataset),
        "planned": progress.planned,
        "bytes": pc.sum(dataset.metadata["file_bytes"]).as_py() or 0,
        "digest": dataset.digest,
        "by_scene": {name: counts.get("archived", 0) for name, counts in progress.by_scene.items()},
        "attempts": progress.attempts,
        "redrawn": progress.redrawn,
        "failed": progress.jobs.get("failed", 0),
        "missing": progress.missing,
        "next": f"factory verify {quoted(root)} --deep",
    }


def print_missing(site: object, progress: Progress) -> None:
    """Prints on stderr how many episodes of a finished run are missing and what to do; nothing if none is missing.

    Args:
        site: the dataset's directory or URL.
        progress: progress of the run.
    """
    if not progress.missing:
        return
    ends = {state: progress.jobs.get(state, 0) for state in ("failed", "cancelled")}
    counts = ", ".join(f"{count} {state}" for state, count in ends.items() if count)
    state = next((state for state, count in ends.items() if count), "failed")
    click.echo(
        f"error: {progress.missing} of {progress.planned} episodes are missing ({counts}): list the reasons with "
        f"`factory jobs list {quoted(site)} --state {state}`, requeue an episode with `factory jobs retry "
        f"{quoted(site)} EPISODE`",
        err=True,
    )


def print_summary(summary: dict[str, Any]) -> None:
    """Prints the summary as text."""
    size = f"{summary['bytes'] / 1e6:.3g} MB" if summary["bytes"] < 1e7 else f"{summary['bytes'] / 1e6:.0f} MB"
    print_text(f"dataset {summary['dataset']}: {summary['episodes']} of {summary['planned']} episodes, {size}")
    print_text(f"digest  {summary['digest']}")
    print_table("", ("scene", "episodes"), summary["by_scene"].items())
    tries = ", ".join(f"{count} {_WORDS.get(outcome, outcome)}" for outcome, count in summary["attempts"].items())
    print_text(f"attempts: {tries}; targets redrawn: {summary['redrawn']}")
    print_text(f"next:    {summary['next']}")
    print_text(f"page:    factory serve {quoted(summary['dataset'])}")
