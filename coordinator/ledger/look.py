"""A read-only look at a ledger, for those who report. Opens and closes; writes nothing, needs no coordinator."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from sqlalchemy.engine import Connection

from coordinator.ledger.engine import open_reader

__all__ = ["Connection", "look_into"]


@contextmanager
def look_into(url: str) -> Iterator[Connection]:
    """Opens the ledger at a URL for reading.

    Raises:
        WorldError: there is no ledger.
    """
    engine = open_reader(url)
    try:
        with engine.connect() as connection:
            yield connection
    finally:
        engine.dispose()
