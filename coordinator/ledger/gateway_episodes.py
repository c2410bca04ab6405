"""Records which archived episodes a gateway stores; the core stores the others. Does not change jobs.

The table of the gateways' episodes is named `keepers` in the database. A ledger of format 1 gets the table when it is
opened for writing.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from sqlalchemy import delete, func, insert, inspect, select
from sqlalchemy.engine import Connection

from coordinator.archive.difference import RecordedFile
from coordinator.ledger.tables import episodes, gateway_episodes

_ROWS = 1000
_KEPT = select(episodes.c.idx, episodes.c.size).join(gateway_episodes, gateway_episodes.c.idx == episodes.c.idx)


def record_at_gateway(connection: Connection, index: int, gateway: str) -> None:
    """Records that a gateway stores a newly archived episode."""
    connection.execute(insert(gateway_episodes), {"idx": index, "gateway": gateway})


def record_at_core(connection: Connection, index: int) -> None:
    """Records that the core stores an episode."""
    connection.execute(delete(gateway_episodes).where(gateway_episodes.c.idx == index))


def is_recorded_at_gateway(connection: Connection, index: int, gateway: str, sha256: str) -> bool:
    """Returns whether the ledger records a file with this digest at the gateway."""
    same = (episodes.c.idx == index, episodes.c.sha256 == sha256, gateway_episodes.c.gateway == gateway)
    return connection.execute(_KEPT.where(*same)).first() is not None


def records_of_gateway(
    connection: Connection, gateway: str, first: int, last: int
) -> Iterator[tuple[int, RecordedFile]]:
    """Yields the record of each episode of a gateway with a number from `first` to `last`, ascending."""
    query = _KEPT.where(gateway_episodes.c.gateway == gateway, gateway_episodes.c.idx.between(first, last)).order_by(
        gateway_episodes.c.idx
    )
    with connection.execute(query.execution_options(yield_per=_ROWS)) as rows:
        for row in rows:
            yield row.idx, RecordedFile(row.size)


def recorded_files(connection: Connection, *, digests: bool = True) -> Mapping[int, RecordedFile]:
    """Returns the record of every archived episode, with the gateway that keeps it.

    Args:
        connection: connection for reading.
        digests: whether the records contain digests, which are half of their size.
    """
    away = gateways_by_episode(connection)
    columns = (episodes.c.idx, episodes.c.size, *((episodes.c.sha256,) if digests else ()))
    rows = connection.execute(select(*columns).execution_options(yield_per=_ROWS))
    return {row.idx: RecordedFile(row.size, row.sha256 if digests else None, away.get(row.idx)) for row in rows}


def gateways_by_episode(connection: Connection) -> Mapping[int, str]:
    """Returns the gateway of every episode that a gateway stores, ordered by episode number."""
    if not inspect(connection).has_table(gateway_episodes.name):
        return {}
    return {
        row.idx: row.gateway for row in connection.execute(select(gateway_episodes).order_by(gateway_episodes.c.idx))
    }


def count_by_gateway(connection: Connection) -> Mapping[str, int]:
    """Returns the number of episodes per gateway."""
    if not inspect(connection).has_table(gateway_episodes.name):
        return {}
    query = (
        select(gateway_episodes.c.gateway, func.count())
        .group_by(gateway_episodes.c.gateway)
        .order_by(gateway_episodes.c.gateway)
    )
    return {row[0]: row[1] for row in connection.execute(query)}
