"""Measures the CPU time of inserting the episodes of many layouts into a ledger. Builds no layout.

Arguments: `PACKAGE [LAYOUTS] [LEDGER]`. PACKAGE is the package of one home; it is used for every layout. LAYOUTS is the
number of layouts to insert, by default all 10,000. LEDGER is the file of a database that is kept, so a killed run
can be continued.
"""

from __future__ import annotations

import resource
import sys
import tempfile
import time
from datetime import UTC, datetime
from pathlib import Path

from coordinator.expansion.catalog import SceneEntry, read_entry
from coordinator.expansion.draw import expand_layout
from coordinator.ledger.builds import built_layouts, number_of_layout, open_builds
from coordinator.ledger.database.engine import open_writer
from coordinator.ledger.opening import holds_run, open_run
from coordinator.ledger.reading.progress import read_progress
from coordinator.ledger.repair import adopt_package
from schemas.plan import Plan

_LAYOUTS, _EPISODES = 10_000, 1_000_000


def main() -> None:
    """Prints the CPU time of opening the ledger, inserting episodes and reading the progress, and the peak memory."""
    entry, layouts = read_entry(Path(sys.argv[1])), int(sys.argv[2]) if len(sys.argv) > 2 else _LAYOUTS
    plan = Plan.model_validate(
        {
            "name": "million",
            "scenes": [{"name": "home", "layouts": _LAYOUTS, "episodes": _EPISODES}],
            "splits": {"train_id": 0.6, "test_id": 0.1, "test_unseen_scene": 0.2, "test_unseen_scene_ood_obj": 0.1},
            "balance": "categories",
            "expert": "planner",
            "record": "states",
            "task": {"success": "surface"},
        }
    )
    if len(sys.argv) > 3:
        expand(plan, entry, layouts, Path(sys.argv[3]))
    else:
        with tempfile.TemporaryDirectory() as folder:
            expand(plan, entry, layouts, Path(folder) / "ledger.db")


def expand(plan: Plan, entry: SceneEntry, layouts: int, ledger: Path) -> None:
    """Inserts the episodes of the layouts that the ledger does not contain yet, each layout in one transaction."""
    now = datetime.now(UTC)
    engine = open_writer(f"sqlite:///{ledger}")
    with engine.connect() as connection:
        built = dict.fromkeys(built_layouts(connection, plan.episodes) if holds_run(connection) else (), entry)
    open_run(engine, plan, built, 15.0, now)
    _say(f"opened, {len(built)} layouts inserted by an earlier run")
    with engine.begin() as connection:
        builds = open_builds(connection)[:layouts]
    for number, build in enumerate(builds, start=1):
        planned = tuple(expand_layout(plan, number_of_layout(plan, build), plan.spans[build.scene][0], entry))
        with engine.begin() as connection:
            adopt_package(connection, build, entry.sha256, entry.size, planned, now)
        if number % 1000 == 0:
            _say(f"{number} layouts inserted")
    _say(f"{len(builds)} layouts inserted")
    with engine.connect() as connection:
        progress = read_progress(connection, now)
    _say(f"progress read, {progress.planned} episodes")
    engine.dispose()


def _say(what: str) -> None:
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss >> 10
    sys.stdout.write(f"{time.process_time():.2f} s CPU, {memory} MiB: {what}\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main()
