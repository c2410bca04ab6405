"""Stores the memory of the hosts of a run in the table `info`, for the web page."""

from __future__ import annotations

from collections.abc import Mapping

from pydantic import TypeAdapter, ValidationError
from sqlalchemy import select
from sqlalchemy.engine import Connection

from coordinator.ledger.opening import write_info
from coordinator.ledger.tables import info
from schemas.protocol.messages import HostMemory

_KEY = "memory"
_BY_HOST = TypeAdapter(dict[str, HostMemory])


def write_memory(connection: Connection, memory: Mapping[str, HostMemory]) -> None:
    """Replaces the memory of all hosts.

    Args:
        connection: connection with an open transaction.
        memory: memory by name of the host.
    """
    write_info(connection, {_KEY: _BY_HOST.dump_json(dict(memory)).decode()})


def read_memory(connection: Connection) -> dict[str, HostMemory]:
    """Returns the memory by name of the host; empty before the first heartbeat."""
    text = connection.execute(select(info.c.value).where(info.c.key == _KEY)).scalar()
    try:
        return _BY_HOST.validate_json(text) if text else {}
    except ValidationError:
        return {}
