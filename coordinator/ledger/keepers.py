"""Which archived episodes a gateway keeps; the others lie in the core's own directory. Moves no job.

Ledgers of format 1 know no gateways and have no such table until they are opened for writing.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from sqlalchemy import delete, func, insert, inspect, select
from sqlalchemy.engine import Connection

from coordinator.archive.difference import RecordedFile
from coordinator.ledger.tables import episodes, keepers

__all__ = ["all_keepers", "bring_home", "count_by_gateway", "is_kept", "kept_by", "note_keeper", "recorded_files"]

_ROWS = 1000
_KEPT = select(episodes.c.idx, episodes.c.size).join(keepers, keepers.c.idx == episodes.c.idx)


def note_keeper(connection: Connection, index: int, gateway: str) -> None:
    """Records that an episode archived just now lies at a gateway."""
    connection.execute(insert(keepers), {"idx": index, "gateway": gateway})


def bring_home(connection: Connection, index: int) -> None:
    """Records that an episode lies in the core's own directory now."""
    connection.execute(delete(keepers).where(keepers.c.idx == index))


def is_kept(connection: Connection, index: int, gateway: str, sha256: str) -> bool:
    """Returns whether a gateway keeps this very file for the ledger."""
    same = (episodes.c.idx == index, episodes.c.sha256 == sha256, keepers.c.gateway == gateway)
    return connection.execute(_KEPT.where(*same)).first() is not None


def kept_by(connection: Connection, gateway: str, first: int, last: int) -> Iterator[tuple[int, RecordedFile]]:
    """Yields the record of each episode that a gateway keeps, between two numbers, both included; ascending."""
    query = _KEPT.where(keepers.c.gateway == gateway, keepers.c.idx.between(first, last)).order_by(keepers.c.idx)
    with connection.execute(query.execution_options(yield_per=_ROWS)) as rows:
        for row in rows:
            yield row.idx, RecordedFile(row.size)


def recorded_files(connection: Connection) -> Mapping[int, RecordedFile]:
    """Returns the record of every archived episode, with the gateway that keeps it."""
    away = all_keepers(connection)
    rows = connection.execute(select(episodes.c.idx, episodes.c.size, episodes.c.sha256))
    return {row.idx: RecordedFile(row.size, row.sha256, away.get(row.idx)) for row in rows}


def all_keepers(connection: Connection) -> Mapping[int, str]:
    """Returns the gateway of every episode that lies at one, in the order of the plan."""
    if not inspect(connection).has_table(keepers.name):
        return {}
    return {row.idx: row.gateway for row in connection.execute(select(keepers).order_by(keepers.c.idx))}


def count_by_gateway(connection: Connection) -> Mapping[str, int]:
    """Returns how many episodes lie at which gateway."""
    if not inspect(connection).has_table(keepers.name):
        return {}
    query = select(keepers.c.gateway, func.count()).group_by(keepers.c.gateway).order_by(keepers.c.gateway)
    return {row[0]: row[1] for row in connection.execute(query)}
