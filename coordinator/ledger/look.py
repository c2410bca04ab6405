"""A read-only look at a ledger, for those who report. Opens and closes; writes nothing, needs no coordinator."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from sqlalchemy.engine import Connection
from sqlalchemy.exc import DatabaseError

from coordinator.ledger.engine import open_reader, shown_url
from schemas.errors import WorldError

__all__ = ["Connection", "look_into"]


@contextmanager
def look_into(url: str) -> Iterator[Connection]:
    """Opens the ledger at a URL for reading.

    Raises:
        WorldError: there is no ledger, or what is read in the block cannot be read.
    """
    engine = open_reader(url)
    try:
        with engine.connect() as connection:
            yield connection
    except DatabaseError as error:
        raise WorldError(
            f"the ledger {shown_url(url)} cannot be read: {error.orig}; `factory repair` rebuilds it from the episodes"
        ) from error
    finally:
        engine.dispose()
