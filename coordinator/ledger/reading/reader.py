"""Opens a ledger read-only and converts database errors. Does not write and needs no coordinator."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from sqlalchemy.engine import Connection
from sqlalchemy.exc import DatabaseError

from coordinator.ledger.database.engine import is_outage, open_reader, remedy_for, shown_url
from coordinator.ledger.opening import require_current_format
from coordinator.ledger.reading.audit import ledger_trouble
from schemas.errors import FactoryError, TransientError, WorldError

__all__ = ["Connection", "open_ledger", "require_sound", "translate_damage"]


@contextmanager
def open_ledger(url: str) -> Iterator[Connection]:
    """Opens a ledger read-only; a context manager that yields the connection.

    Raises:
        WorldError: the ledger does not exist, or data read in the block are damaged.
        UsageError: the ledger has another format.
    """
    engine = open_reader(url)
    try:
        with translate_damage(url), engine.connect() as connection:
            require_current_format(connection)
            yield connection
    finally:
        engine.dispose()


@contextmanager
def translate_damage(url: str) -> Iterator[None]:
    """Converts exceptions of the block to `WorldError` if the ledger is damaged; other exceptions are re-raised.

    If a database server does not answer, the exception is `TransientError`.

    The function audits the ledger, because with an intact ledger the exception is an error in the software.
    """
    try:
        yield
    except DatabaseError as error:
        reason = " ".join(str(error.orig).split())
        if is_outage(url, error):
            raise TransientError(
                f"the server of the ledger {shown_url(url)} does not answer ({reason}): start it, then try again"
            ) from error
        raise WorldError(f"the ledger {shown_url(url)} cannot be read: {reason}; {remedy_for(url)}") from error
    except FactoryError:
        raise
    except Exception as error:
        require_sound(url, error)
        raise


def require_sound(url: str, cause: Exception | None = None) -> None:
    """Checks that a ledger is intact.

    Raises:
        WorldError: the ledger is damaged; the message describes the damage.
        UsageError: the ledger has another format.
    """
    trouble = ledger_trouble(url)
    if trouble:
        raise WorldError(f"the ledger {shown_url(url)} {trouble}; {remedy_for(url)}") from cause
