"""Adds one hostile peer and one faulty host to the honest hosts of a round, and reads the effects from the ledger."""

from __future__ import annotations

import random
import sqlite3
from contextlib import closing
from dataclasses import dataclass

from tests.chaos.cluster import FAULTY_HOST, ChaosCluster
from tests.chaos.fault_span import FaultSpan
from tests.chaos.hostile_peer import HOSTILE_HOST, HOSTILE_KINDS

_LAST_STRIKE = 7
_REFUSED, _CRASHED = "bundle of a faulty host refused", "simulation of a faulty host crashed"
_BARRED = {HOSTILE_HOST: "hostile peer barred", FAULTY_HOST: "faulty host barred"}
_OUTCOMES = {"invalid": _REFUSED, "crash": _CRASHED, "hang": _CRASHED}
PEER_KINDS = (*HOSTILE_KINDS, _REFUSED, _CRASHED, *_BARRED.values())


@dataclass(frozen=True)
class Peers:
    """Settings of the hostile peer and the faulty host in a round."""

    pause_s: tuple[float, float] = (0.1, 0.6)
    """Shortest and longest pause between two attacks of the hostile peer, seconds."""
    damages: tuple[float, ...] = (0.3, 1.0)
    """Shares of attempts that the faulty host damages; one is drawn for each round."""


def preload_strikes(cluster: ChaosCluster, rng: random.Random) -> bool:
    """Gives the hostile peer or the faulty host seven strikes; the eighth strike bars it.

    A round is too short for a host to get all eight strikes.

    Returns:
        Whether the ledger was updated; otherwise the caller retries.
    """
    host = rng.choice(tuple(_BARRED))
    row = (host, _LAST_STRIKE, 0, 0.0, "history")
    try:
        with (
            closing(sqlite3.connect(f"file:{cluster.out / 'ledger.db'}?mode=rw", uri=True, timeout=1.0)) as ledger,
            ledger,
        ):
            ledger.execute(
                "insert or replace into hosts (host, strikes, last_job, resumes_at, reason) values (?, ?, ?, ?, ?)", row
            )
    except sqlite3.DatabaseError:  # the ledger is missing or busy, or the disk is full
        return False
    return True


def effects_of_peers(cluster: ChaosCluster) -> list[tuple[str, FaultSpan]]:
    """Returns an effect for each failed attempt of the faulty host and for each barred host; reads an ended run."""
    failed = cluster.query(f"select outcome, count(*) from attempts where sid like '{FAULTY_HOST}.%' group by outcome")
    seen = [
        (_OUTCOMES[outcome], FaultSpan(1)) for outcome, count in failed if outcome in _OUTCOMES for _ in range(count)
    ]
    barred = cluster.query("select host from hosts where barred_at is not null")
    return seen + [(_BARRED[host], FaultSpan(1)) for (host,) in barred if host in _BARRED]
