"""The closing words of a run: what was made, where it lies, what to type next."""

from __future__ import annotations

from typing import Any

import click

from coordinator.archive.place import Place
from factory.cli.output import print_table, print_text
from factory.dataset import Dataset
from schemas.terms import FailReason
from schemas.wire import Progress

__all__ = ["print_summary", "summarise"]

_WORDS = {str(FailReason.RELEASED): "given back"}
"""What an outcome is called where its own name says little."""


def summarise(root: Place, progress: Progress) -> dict[str, Any]:
    """Returns the facts of a finished run as plain data."""
    dataset = Dataset(root)
    sizes = [path.stat().st_size for path in (root / "episodes").glob("ep_*.zip")]
    return {
        "dataset": str(root),
        "run": progress.run,
        "episodes": len(dataset),
        "planned": progress.planned,
        "bytes": sum(sizes),
        "digest": dataset.digest,
        "by_scene": {name: counts.get("archived", 0) for name, counts in progress.by_scene.items()},
        "attempts": progress.attempts,
        "redrawn": progress.redrawn,
        "failed": progress.jobs.get("failed", 0),
        "next": f"factory verify {root} --deep",
    }


def print_summary(summary: dict[str, Any]) -> None:
    """Prints the facts for people."""
    size = f"{summary['bytes'] / 1e6:.0f} MB"
    print_text(f"dataset {summary['dataset']}: {summary['episodes']} of {summary['planned']} episodes, {size}")
    print_text(f"digest  {summary['digest']}")
    print_table("", ("scene", "episodes"), summary["by_scene"].items())
    tries = ", ".join(f"{count} {_WORDS.get(outcome, outcome)}" for outcome, count in summary["attempts"].items())
    print_text(f"attempts: {tries}; targets redrawn: {summary['redrawn']}")
    if summary["failed"]:
        click.echo(f"{summary['failed']} jobs failed: factory jobs list {summary['dataset']} --state failed", err=True)
    print_text(f"next:    {summary['next']}")
