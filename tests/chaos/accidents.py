"""Damages the ledger of a stopped coordinator: deletes it, restores an older copy, truncates it or flips bits."""

from __future__ import annotations

import random
import shutil
import sqlite3
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from pathlib import Path

_LOG, _SHARED = "ledger.db-wal", "ledger.db-shm"
_PAGE = 4096

Accident = Callable[[Path, Sequence[Path], random.Random], str]
"""(dataset, older copies of its ledger, random generator) -> description of the damage."""


def copy_ledger(out: Path, folder: Path) -> Path:
    """Copies a ledger, write-ahead log included, with the backup function of SQLite."""
    folder.mkdir(parents=True)
    with (
        closing(sqlite3.connect(f"file:{out / 'ledger.db'}?mode=ro", uri=True)) as source,
        closing(sqlite3.connect(folder / "ledger.db")) as target,
    ):
        source.backup(target)
    return folder


def _delete(out: Path, _copies: Sequence[Path], rng: random.Random) -> str:
    names = rng.choice((("ledger.db",), ("ledger.db", _LOG, _SHARED), ("ledger.db", _SHARED)))
    for name in names:
        (out / name).unlink(missing_ok=True)
    return f"deleted {', '.join(names)}"


def _restore_older(out: Path, copies: Sequence[Path], rng: random.Random) -> str:
    copy = rng.choice(copies)
    leftovers = [name for name in (_LOG, _SHARED) if rng.random() < 0.5]
    for name in (_LOG, _SHARED):
        if name not in leftovers:
            (out / name).unlink(missing_ok=True)
    shutil.copy(copy / "ledger.db", out / "ledger.db")
    return f"restored {copy.name}, left {', '.join(leftovers) or 'no log'}"


def _truncate(out: Path, _copies: Sequence[Path], rng: random.Random) -> str:
    name = rng.choice([name for name in ("ledger.db", _LOG) if (out / name).exists()])
    size = (out / name).stat().st_size
    cut = rng.choice((0, rng.randrange(size + 1), rng.randrange(size // _PAGE + 1) * _PAGE))
    with (out / name).open("r+b") as file:
        file.truncate(cut)
    return f"truncated {name} from {size} to {cut} bytes"


def _damage(out: Path, _copies: Sequence[Path], rng: random.Random) -> str:
    if rng.random() < 0.7:  # otherwise SQLite would replay the log over the damage
        with closing(sqlite3.connect(out / "ledger.db")) as raw:
            raw.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    name = rng.choice([name for name in ("ledger.db", _LOG) if (out / name).exists() and (out / name).stat().st_size])
    data = bytearray((out / name).read_bytes())
    if rng.random() < 0.25:
        start = rng.randrange(len(data))
        data[start : start + _PAGE] = bytes(len(data[start : start + _PAGE]))
        how = f"{_PAGE} zeros at {start}"
    else:
        count = rng.choice((1, 1, 5, 200))
        for _ in range(count):
            data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
        how = f"{count} bits flipped"
    (out / name).write_bytes(data)
    return f"damaged {name}: {how}"


ACCIDENTS: Mapping[str, Accident] = {
    "ledger deleted": _delete,
    "older copy restored": _restore_older,
    "ledger truncated": _truncate,
    "ledger damaged": _damage,
}
