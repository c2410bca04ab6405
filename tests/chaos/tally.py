"""Counts of a campaign; adds them up over rounds, stores them in a file and prints them as a table."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

from rich.console import Console
from rich.table import Table

_FORMER_NAMES = {"unfelt": "without_effect"}


@dataclass
class Tally:
    """Counts of one round or of several."""

    faults: Counter[str] = field(default_factory=Counter)
    """Fault -> how often it had an effect."""
    without_effect: Counter[str] = field(default_factory=Counter)
    """Fault -> how often it had no effect; not included in `faults`."""
    missing: dict[str, str] = field(default_factory=dict)
    """Fault -> why this machine does not support it."""
    rounds: Counter[str] = field(default_factory=Counter)
    """Topology -> number of rounds."""
    episodes: int = 0
    outcomes: Counter[str] = field(default_factory=Counter)
    restarts: Counter[str] = field(default_factory=Counter)
    violations: list[str] = field(default_factory=list)
    seconds: float = 0.0

    def add(self, other: Tally) -> None:
        """Adds the counts of another round, but not its duration."""
        for mine, more in (
            (self.faults, other.faults),
            (self.without_effect, other.without_effect),
            (self.rounds, other.rounds),
            (self.outcomes, other.outcomes),
            (self.restarts, other.restarts),
        ):
            mine.update(more)
        self.missing |= other.missing
        self.episodes += other.episodes
        self.violations += other.violations

    def to_plain(self) -> dict[str, Any]:
        """Returns the tally as JSON values."""
        return {name: dict(value) if isinstance(value, Counter) else value for name, value in vars(self).items()}

    @classmethod
    def from_plain(cls, plain: dict[str, Any]) -> Self:
        """Reads the values of `to_plain`; also accepts the field names of older versions."""
        plain = {_FORMER_NAMES.get(name, name): value for name, value in plain.items()}
        empty = vars(cls())
        return cls(
            **{name: Counter(value) if isinstance(empty[name], Counter) else value for name, value in plain.items()}
        )

    def save(self, path: Path) -> None:
        """Writes the tally to a file atomically."""
        beside = path.with_name(f"{path.name}.part")
        beside.write_text(json.dumps(self.to_plain(), indent=2) + "\n")
        beside.replace(path)

    @classmethod
    def load(cls, path: Path) -> Self:
        """Reads a tally from a file; returns an empty tally if the file does not exist."""
        return cls.from_plain(json.loads(path.read_text())) if path.exists() else cls()

    def print(self, out: Console, kinds: Iterable[str]) -> None:
        """Prints faults by kind, rounds, episodes and violations."""
        table = Table("fault", "with effect", "without effect", box=None, header_style="bold")
        for column in table.columns[1:]:
            column.justify = "right"
        for kind in kinds:
            effects = str(self.faults[kind]) if kind not in self.missing else f"not supported: {self.missing[kind]}"
            table.add_row(kind, effects, str(self.without_effect[kind] or ""))
        table.add_row("all", str(self.faults.total()), str(self.without_effect.total()), style="bold")
        out.print(table)
        rounds = ", ".join(f"{count} {where}" for where, count in sorted(self.rounds.items()))
        out.print(f"{self.rounds.total()} rounds ({rounds}), {self.episodes} episodes in {self.seconds:.0f} s")
        out.print("attempts: " + _listed(self.outcomes))
        out.print("unplanned restarts: " + _listed(self.restarts))
        out.print(f"violations = {len(self.violations)}", style="bold")
        for text in self.violations:
            out.print(f"  {text}")


def _listed(counts: Counter[str]) -> str:
    return ", ".join(f"{count} {what}" for what, count in counts.most_common()) or "none"
