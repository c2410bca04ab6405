"""Records where archived episodes are, and which of them only their worker has validated. Does not change jobs.

The core stores the episodes that no gateway stores; the table of the gateways' episodes is named `keepers` in the
database. `coordinator.recheck` validates unchecked episodes; a host with an invalid bundle is barred.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from datetime import datetime

from sqlalchemy import bindparam, delete, func, insert, select
from sqlalchemy.engine import Connection

from coordinator.archive.difference import RecordedFile
from coordinator.ledger.database.prepared import PreparedStatement
from coordinator.ledger.tables import episodes, gateway_episodes, hosts, unchecked_episodes

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
    return {
        row.idx: row.gateway for row in connection.execute(select(gateway_episodes).order_by(gateway_episodes.c.idx))
    }


def count_by_gateway(connection: Connection) -> Mapping[str, int]:
    query = (
        select(gateway_episodes.c.gateway, func.count())
        .group_by(gateway_episodes.c.gateway)
        .order_by(gateway_episodes.c.gateway)
    )
    return {row[0]: row[1] for row in connection.execute(query)}


_ADD = PreparedStatement(insert(unchecked_episodes))
_SUSPECT = (
    select(unchecked_episodes.c.idx)
    .join(hosts, hosts.c.host == unchecked_episodes.c.host)
    .where(hosts.c.barred_at.is_not(None))
    .order_by(unchecked_episodes.c.idx)
    .limit(bindparam("most"))
)


def note_unchecked(connection: Connection, index: int, host: str) -> None:
    """Records that an episode was validated by its worker only. Runs in the transaction that archives it."""
    _ADD.count(connection, {"idx": index, "host": host})


def note_checked(connection: Connection, index: int) -> None:
    """Records that the coordinator has validated an episode completely."""
    connection.execute(delete(unchecked_episodes).where(unchecked_episodes.c.idx == index))


def count_unchecked(connection: Connection) -> int:
    """Returns the number of archived episodes whose frames only their worker has validated."""
    return connection.execute(select(func.count()).select_from(unchecked_episodes)).scalar_one()


def suspects(connection: Connection, most: int) -> Sequence[int]:
    """Returns the numbers of unchecked episodes of barred hosts, ascending, at most `most`."""
    return connection.execute(_SUSPECT, {"most": most}).scalars().all()


def bar_at_once(connection: Connection, host: str, reason: str, now: datetime) -> None:
    """Bars a host that announced an invalid bundle as valid. Runs in the transaction that refuses the bundle.

    The caller has recorded the failure before, so the host has a row in the table `hosts`.
    """
    at = {"barred_at": now.timestamp(), "reason": reason}
    connection.execute(hosts.update().where(hosts.c.host == host, hosts.c.barred_at.is_(None)).values(at))
