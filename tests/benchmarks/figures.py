"""Runs benchmarks and prints the measured values with their targets in one table. Asserts nothing.

Wall-clock times are meaningful only on an otherwise idle machine; the table shows the load before each benchmark.

    python -m tests.benchmarks.figures [rollout] [render] [coordinator] [read] [loader]
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from typing import Any, NamedTuple

from factory.support.terminal import print_table

COORDINATOR = ["--jobs", "1000000", "--workers", "64", "--sessions", "2000", "--bundle-mb", "32"]
BENCHES = {
    "rollout": ["factory", "bench", "rollout", "--against", "plain"],
    "render": ["factory", "bench", "render", "--size", "224"],
    "coordinator": ["tests.benchmarks.coordinator", *COORDINATOR],
    "read": ["factory", "bench", "read"],
    "loader": ["factory", "bench", "read", "--size", "224"],
}
"""Module and arguments of each benchmark."""


class Figure(NamedTuple):
    """One measured value and its target."""

    what: str
    measured: float
    target: float
    at_most: bool = False

    def row(self) -> tuple[str, float, str, str]:
        """Returns the row of the table: name, measured value, target, and whether the target is reached."""
        reached = self.measured <= self.target if self.at_most else self.measured >= self.target
        return self.what, self.measured, f"{'<=' if self.at_most else '>='} {self.target:g}", "yes" if reached else "no"


def of_rollout(report: dict[str, Any]) -> Iterator[Figure]:
    """Rollout on one core. Each scene has three targets: real time (60 frames per second), 20 times the speed of
    the plain pipeline, and at most 1 GiB of memory."""
    for scene, found in report["scenes"].items():
        yield Figure(f"{scene}: frames/s per core", found["frames_per_s_per_core"], 60)
        yield Figure(f"{scene}: times plain PyBullet", found["ratio"], 20)
        yield Figure(f"{scene}: peak memory, MiB", found["memory"]["peak_mib"], 1024, at_most=True)


def of_coordinator(report: dict[str, Any]) -> Iterator[Figure]:
    """Coordinator with a ledger of a million jobs."""
    wire = report["wire"]
    yield Figure("claim + done over zenoh, cycles/s", wire["cycles_per_s"]["median"], 1000)
    yield Figure("start on the ledger, s (target for 100k jobs)", wire["start_s"]["median"], 3, at_most=True)
    sessions, deliveries = wire["session_load"], wire["delivery_load"]
    yield Figure(f"memory with {sessions['sessions']} sessions, MiB", sessions["memory"]["peak_mib"], 400, at_most=True)
    at_once = f"{deliveries['workers']} x {deliveries['bundle_mb']:g} MB at once"
    yield Figure(f"{at_once}: peak memory, MiB", deliveries["memory"]["peak_mib"], 200, at_most=True)
    yield Figure(f"{at_once}: claim of another worker, p99 ms", deliveries["claim_p99_ms"], 50, at_most=True)


def of_read(report: dict[str, Any]) -> Iterator[Figure]:
    """Random access to decoded frames."""
    yield Figure("random frames (colour, depth, ids)/s per core", report["random_frames_per_s"]["median"], 250)


def of_render(report: dict[str, Any]) -> Iterator[Figure]:
    """Frames of 224 x 224 pixels: colour, depth and ids, rendered on one core."""
    for scene, found in report["scenes"].items():
        yield Figure(f"{scene}: 224 x 224 frames/s per core", found["frames_per_s"]["median"], 250)


def of_loader(report: dict[str, Any]) -> Iterator[Figure]:
    """PyTorch loader of rendered frames on all cores; the target of the speedup assumes two cores."""
    rates = {name: report[f"{name}_frames_per_s"] for name in ("one_thread", "threads", "loader")}
    if all(rates.values()):  # torch is installed
        alone, *others = (rate["median"] for rate in rates.values())
        yield Figure("rendered frames/s, loader with one thread", alone, 250)
        for name, rate in zip(("threads", "worker processes"), others, strict=True):
            yield Figure(f"rendered frames/s with {name}, times one thread", rate / alone, 1.7)


FIGURES = {
    "rollout": of_rollout,
    "render": of_render,
    "coordinator": of_coordinator,
    "read": of_read,
    "loader": of_loader,
}


def main(names: list[str]) -> None:
    """Runs the named benchmarks, or all, and prints their results."""
    rows = []
    for name in names or list(BENCHES):
        command = [sys.executable, "-m", *BENCHES[name], "--json"]
        report = json.loads(subprocess.run(command, check=True, stdout=subprocess.PIPE).stdout)
        rows += [figure.row() for figure in FIGURES[name](report)]
        rows.append((f"(load before `{name}`)", report["machine"]["load_1m"], "", ""))
    print_table("figures and targets", ("what", "measured", "target", "reached"), rows)


if __name__ == "__main__":
    main(sys.argv[1:])
