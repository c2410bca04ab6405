"""What a campaign has seen: counts that add up over rounds, go to a file and come back, and print as a table."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

from rich.console import Console
from rich.table import Table

__all__ = ["Tally"]


@dataclass
class Tally:
    """Of one round, or of many."""

    faults: Counter[str] = field(default_factory=Counter)
    """Fault -> how often it was felt."""
    unfelt: Counter[str] = field(default_factory=Counter)
    """Fault -> how often it came to nothing; not among `faults`."""
    missing: dict[str, str] = field(default_factory=dict)
    """Fault -> why it could not be had."""
    rounds: Counter[str] = field(default_factory=Counter)
    """Topology -> rounds."""
    episodes: int = 0
    outcomes: Counter[str] = field(default_factory=Counter)
    restarts: Counter[str] = field(default_factory=Counter)
    violations: list[str] = field(default_factory=list)
    seconds: float = 0.0

    def add(self, other: Tally) -> None:
        """Adds what another round has seen; the seconds are the campaign's own."""
        for mine, more in (
            (self.faults, other.faults),
            (self.unfelt, other.unfelt),
            (self.rounds, other.rounds),
            (self.outcomes, other.outcomes),
            (self.restarts, other.restarts),
        ):
            mine.update(more)
        self.missing |= other.missing
        self.episodes += other.episodes
        self.violations += other.violations

    def to_plain(self) -> dict[str, Any]:
        """Returns it as JSON has it."""
        return {name: dict(value) if isinstance(value, Counter) else value for name, value in vars(self).items()}

    @classmethod
    def from_plain(cls, plain: dict[str, Any]) -> Self:
        """Returns what `to_plain` made."""
        empty = vars(cls())
        return cls(
            **{name: Counter(value) if isinstance(empty[name], Counter) else value for name, value in plain.items()}
        )

    def save(self, path: Path) -> None:
        """Writes it to a file, whole or not at all."""
        beside = path.with_name(f"{path.name}.part")
        beside.write_text(json.dumps(self.to_plain(), indent=2) + "\n")
        beside.replace(path)

    @classmethod
    def load(cls, path: Path) -> Self:
        """Returns what a file holds; an empty one while there is none."""
        return cls.from_plain(json.loads(path.read_text())) if path.exists() else cls()

    def print(self, out: Console, kinds: Iterable[str]) -> None:
        """Prints faults by kind, rounds, episodes and violations."""
        table = Table("fault", "felt", "without effect", box=None, header_style="bold")
        for column in table.columns[1:]:
            column.justify = "right"
        for kind in kinds:
            felt = str(self.faults[kind]) if kind not in self.missing else f"not here: {self.missing[kind]}"
            table.add_row(kind, felt, str(self.unfelt[kind] or ""))
        table.add_row("all", str(self.faults.total()), str(self.unfelt.total()), style="bold")
        out.print(table)
        rounds = ", ".join(f"{count} {where}" for where, count in sorted(self.rounds.items()))
        out.print(f"{self.rounds.total()} rounds ({rounds}), {self.episodes} episodes in {self.seconds:.0f} s")
        out.print("attempts: " + _listed(self.outcomes))
        out.print("left by themselves and started again: " + _listed(self.restarts))
        out.print(f"violations = {len(self.violations)}", style="bold")
        for text in self.violations:
            out.print(f"  {text}")


def _listed(counts: Counter[str]) -> str:
    return ", ".join(f"{count} {what}" for what, count in counts.most_common()) or "none"
