"""Statements that every request needs: spelt once for each kind of database, then run by its driver alone.

They take part in SQLAlchemy's transactions and raise its exceptions. Saved is building statement, parameters and
result anew each time, which takes several times as long as the database needs.
"""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import closing
from typing import Any, NamedTuple

from sqlalchemy import Boolean, Delete, Dialect, Insert, Select, Update
from sqlalchemy.engine import Connection
from sqlalchemy.exc import DBAPIError

__all__ = ["PreparedStatement"]


class _Spelling(NamedTuple):
    """A statement as one kind of database takes it."""

    sql: str
    fixed: Mapping[str, Any]
    """Parameters that the statement gives itself."""
    order: Sequence[str] | None
    """The parameters as they stand; `None` where the driver takes them by name."""


class PreparedStatement:
    """A statement to be run often with other parameters.

    Args:
        statement: with named parameters; an INSERT is given every column but a numbered key. It may not return flags,
            which drivers give as numbers.
    """

    def __init__(self, statement: Insert | Update | Delete | Select[Any]) -> None:
        returned = {column.name: column.type for column in statement.exported_columns}
        if any(isinstance(kind, Boolean) for kind in returned.values()):
            raise TypeError(f"a prepared statement may not return flags; requested: {', '.join(returned)}")
        self.statement = statement.inline() if isinstance(statement, Insert) else statement
        found: Any = namedtuple("Found", returned)  # type: ignore[misc]
        self._row: Callable[[Iterable[Any]], Any] = found._make
        self._spellings: dict[str, _Spelling] = {}

    def first(self, connection: Connection, parameters: Mapping[str, Any]) -> Any | None:
        """Returns the first row, a named tuple of its columns, or `None`.

        Args:
            connection: of a ledger; a transaction begins when none is under way.
            parameters: values of those that the statement leaves open.

        Raises:
            DBAPIError: what the database says, as `Connection.execute` would raise it.
        """
        found = self._run(connection, parameters, _fetch)
        return None if found is None else self._row(found)

    def count(self, connection: Connection, parameters: Mapping[str, Any]) -> int:
        """Returns how many rows were changed; arguments and exceptions as of `first`."""
        return int(self._run(connection, parameters, _count))

    def _run(self, connection: Connection, parameters: Mapping[str, Any], take: Callable[[Any], Any]) -> Any:
        if not connection.in_transaction():
            connection.begin()
        spelling = self._spellings.get(connection.dialect.name) or self._spell(connection.dialect)
        values: Any = {**spelling.fixed, **parameters}
        if spelling.order is not None:
            values = [values[name] for name in spelling.order]
        with closing(connection.connection.cursor()) as cursor:
            try:
                cursor.execute(spelling.sql, values)
                return take(cursor)
            except connection.dialect.loaded_dbapi.Error as error:
                raise _translated(connection, cursor, spelling.sql, values, error) from error

    def _spell(self, dialect: Dialect) -> _Spelling:
        compiled: Any = self.statement.compile(dialect=dialect, column_keys=_keys(self.statement))
        fixed = {name: bind.value for bind, name in compiled.bind_names.items() if not bind.required}
        plain = {name: str(value) if isinstance(value, str) else value for name, value in fixed.items()}
        spelling = _Spelling(str(compiled), plain, compiled.positiontup)
        self._spellings[dialect.name] = spelling
        return spelling


def _fetch(cursor: Any) -> Any:
    return cursor.fetchone()


def _count(cursor: Any) -> Any:
    return cursor.rowcount


def _keys(statement: Insert | Update | Delete | Select[Any]) -> list[str] | None:
    if not isinstance(statement, Insert):
        return None
    table: Any = statement.table
    return [column.name for column in table.c if column is not table.autoincrement_column]


def _translated(connection: Connection, cursor: Any, sql: str, values: Any, error: Any) -> Any:
    """Returns the error as SQLAlchemy's; a connection that is gone is given up, so that the next use makes another."""
    dialect = connection.dialect
    is_gone = dialect.is_disconnect(error, connection.connection.dbapi_connection, cursor)
    base = dialect.loaded_dbapi.Error
    raised = DBAPIError.instance(sql, values, error, base, connection_invalidated=is_gone, dialect=dialect)
    if is_gone:
        connection.invalidate(error)
    return raised
