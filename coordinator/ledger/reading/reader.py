"""A read-only look at a ledger, for those who report. Opens and closes; writes nothing, needs no coordinator."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from sqlalchemy.engine import Connection
from sqlalchemy.exc import DatabaseError

from coordinator.ledger.engine import open_reader, shown_url
from coordinator.ledger.reading.audit import ledger_trouble
from schemas.errors import FactoryError, WorldError

__all__ = ["Connection", "open_ledger", "require_sound", "translate_damage"]

_REMEDY = "`factory repair` rebuilds it from the episodes"


@contextmanager
def open_ledger(url: str) -> Iterator[Connection]:
    """Opens the ledger at a URL for reading.

    Raises:
        WorldError: there is no ledger, or what is read in the block cannot be read or understood.
    """
    engine = open_reader(url)
    try:
        with translate_damage(url), engine.connect() as connection:
            yield connection
    finally:
        engine.dispose()


@contextmanager
def translate_damage(url: str) -> Iterator[None]:
    """Turns what goes wrong in the block into a `WorldError` when the ledger is damaged; else lets it pass.

    A value that cannot be understood is our mistake as long as the ledger is sound, so that is looked at first.
    """
    try:
        yield
    except DatabaseError as error:
        raise WorldError(f"the ledger {shown_url(url)} cannot be read: {error.orig}; {_REMEDY}") from error
    except FactoryError:
        raise
    except Exception as error:
        require_sound(url, error)
        raise


def require_sound(url: str, cause: Exception | None = None) -> None:
    """Makes sure that a ledger can be used.

    Raises:
        WorldError: it is damaged; says how.
        UsageError: it is of a newer format.
    """
    trouble = ledger_trouble(url)
    if trouble:
        raise WorldError(f"the ledger {shown_url(url)} {trouble}; {_REMEDY}") from cause
