"""Helpers for runs of one plan by several engines: commands, progress, and results that must be equal."""

from __future__ import annotations

import sqlite3
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path

from schemas.dataset.meta import read_dataset_meta

HURTS = frozenset({"crash", "hang", "invalid"})
"""Outcomes of attempts that count against a host or a job."""


def factory(*words: object) -> list[str]:
    """Returns the command line that runs `factory` with this interpreter."""
    return [sys.executable, "-P", "-m", "factory", *map(str, words)]


def digest_of(root: Path) -> str:
    """Returns the digest of a complete dataset."""
    meta = read_dataset_meta(root)
    assert meta.dataset_digest is not None
    return meta.dataset_digest


def outcomes(root: Path) -> Counter[str]:
    """Returns the number of attempts by outcome in the ledger of a dataset; empty without a ledger."""
    ledger = root / "ledger.db"
    if not ledger.exists():
        return Counter()
    try:
        with sqlite3.connect(f"file:{ledger}?mode=ro", uri=True) as opened:
            return Counter(dict(opened.execute("SELECT outcome, count(*) FROM attempts GROUP BY outcome").fetchall()))
    except sqlite3.OperationalError:  # a coordinator is creating the ledger
        return Counter()


def archived(root: Path) -> int:
    """Returns the number of archived episodes."""
    return outcomes(root)["success"]


def until(condition: Callable[[], bool], process: subprocess.Popen[bytes], within_s: float = 900.0) -> None:
    """Waits for a condition while a process runs; the time limit only guards against a hang."""
    end = time.monotonic() + within_s
    while not condition():
        assert process.poll() is None, "the process ended early"
        assert time.monotonic() < end, "timed out waiting"
        time.sleep(0.2)
