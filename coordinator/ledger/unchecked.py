"""Records archived episodes whose frames only their worker has validated, and bars hosts of invalid bundles.

Validates no episode; `coordinator.recheck` does.
"""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime

from sqlalchemy import bindparam, delete, func, insert, select
from sqlalchemy.engine import Connection

from coordinator.ledger.database.prepared import PreparedStatement
from coordinator.ledger.tables import hosts, unchecked_episodes

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
