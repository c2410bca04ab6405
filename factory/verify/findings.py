"""Findings of a verification, its report, and their output as JSON data and text. Reads no files."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

from factory.verify.rendering import RenderDifference
from schemas.storage.place import Place


class Kind(StrEnum):
    """Kind of a finding."""

    MISSING = "missing"  # a table lists the file, but it does not exist
    SURPLUS = "surplus"  # an episode file or split table without a metadata row
    FOREIGN = "foreign"  # a file that is not part of a dataset
    TRUNCATED = "truncated"  # the size differs from the recorded size
    CHANGED = "changed"  # the SHA-256 differs from the recorded one
    INVALID = "invalid"  # violates the format, the motion limits or its own digests
    CONTRADICTION = "contradiction"  # the tables contradict the episode, the scene or the plan
    DAMAGED = "damaged"  # a table or scene that cannot be read
    RENDERED = "rendered"  # a frame that is rendered again differs from its digest


@dataclass(frozen=True)
class Finding:
    """Finding of a verification."""

    kind: Kind
    file: str
    """Path relative to the dataset directory."""
    text: str
    """Description of the finding, with values."""


@dataclass
class VerifyReport:
    """Result of a verification."""

    root: Place
    deep: bool
    episodes: int = 0
    """Number of episodes in the tables."""
    rendered: int = 0
    """Number of episodes whose frames were rendered again."""
    complete: bool = False
    """Whether the dataset is marked as complete."""
    digest: str | None = None
    """Digest of the dataset, computed from its tables; `None` when they cannot be read."""
    findings: list[Finding] = field(default_factory=list)
    difference: RenderDifference = field(default_factory=RenderDifference)
    """Comparison of the frames that were rendered again with the recorded ones."""

    @property
    def ok(self) -> bool:
        return not self.findings

    def add(self, kind: Kind, file: str, text: str) -> None:
        self.findings.append(Finding(kind, file, text))

    def plain(self) -> dict[str, Any]:
        """Returns the report as JSON data."""
        return {
            "dataset": str(self.root),
            "deep": self.deep,
            "ok": self.ok,
            "complete": self.complete,
            "episodes": self.episodes,
            "rendered": self.rendered,
            "digest": self.digest,
            "difference": self.difference.plain() if self.rendered else None,
            "findings": [{"kind": each.kind, "file": each.file, "text": each.text} for each in self.findings],
        }


def print_report(report: VerifyReport) -> None:
    """Prints a report as text."""
    import click  # not at the top, because processes that only check import this module

    for finding in report.findings:
        click.echo(f"{finding.kind}: {finding.file}: {finding.text}")
    if report.difference.differing:
        _print_difference(report.difference)
    how = "all bytes checked" if report.deep else "files and tables checked; --deep checks the content of episodes"
    how += f"; frames of {report.rendered} episodes rendered again" if report.rendered else ""
    verdict = "valid" if report.ok else f"{len(report.findings)} findings"
    state = "complete" if report.complete else "incomplete"
    content = f"{report.episodes} episodes, {state}, digest {report.digest}"
    if report.digest is None:
        content = "the tables cannot be read, so the number of episodes and the digest are unknown"
    click.echo(f"{report.root}: {verdict} ({how}); {content}")


def _print_difference(difference: RenderDifference) -> None:
    import click

    from factory.support.terminal import print_table

    click.echo(
        f"{difference.differing} of {difference.frames} rendered frames differ; recorded with "
        f"{' and '.join(sorted(difference.recorded_with))}; rendered with "
        f"{' and '.join(sorted(difference.rendered_with))}"
    )
    plain = difference.plain()["channels"]
    if plain is None:
        click.echo("the recorded pixels are not stored; --reference compares with a dataset that stores them")
        return
    rows = [
        (name, 100 * values["share"], *(values.get(key) for key in ("mean", "largest")))
        for name, values in plain.items()
    ]
    columns = ("channel", "differing values, %", "mean difference", "largest")
    print_table(f"{difference.measured} frames compared; colours in levels of 255, depth in metres", columns, rows)
