"""Prepared statements: compiled once per database dialect, then executed by the database driver directly.

The statements take part in SQLAlchemy's transactions and raise its exceptions. Building
statement, parameters and result for each execution would take several times as long as the work of the database.
A prepared statement must not return Boolean columns, because the drivers return them as integers.
"""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import closing
from typing import Any, NamedTuple

from sqlalchemy import Boolean, Delete, Dialect, Insert, Select, Update
from sqlalchemy.engine import Connection
from sqlalchemy.exc import DBAPIError


class _Compiled(NamedTuple):
    """Statement compiled for one dialect."""

    sql: str
    """SQL text."""
    fixed: Mapping[str, Any]
    """Parameters that the statement defines."""
    order: Sequence[str] | None
    """Names of positional parameters in order; `None` if the driver uses named parameters."""


class PreparedStatement:
    """Statement for frequent execution with different parameters.

    Args:
        statement: statement with named parameters. An INSERT requires every column except an autoincrement key. The
            statement must not return Boolean columns, which drivers return as integers.
    """

    def __init__(self, statement: Insert | Update | Delete | Select[Any]) -> None:
        returned = {column.name: column.type for column in statement.exported_columns}
        if any(isinstance(kind, Boolean) for kind in returned.values()):
            raise TypeError(f"a prepared statement must not return Boolean columns; requested: {', '.join(returned)}")
        self.statement = statement.inline() if isinstance(statement, Insert) else statement
        row_type: Any = namedtuple("Found", returned)  # type: ignore[misc]
        self._row: Callable[[Iterable[Any]], Any] = row_type._make
        self._compiled: dict[str, _Compiled] = {}

    def first(self, connection: Connection, parameters: Mapping[str, Any]) -> Any | None:
        """Executes the statement and returns the first row as a named tuple, or `None`.

        Args:
            connection: connection to a ledger; a transaction begins if none is active.
            parameters: values of the bound parameters.

        Raises:
            DBAPIError: the same errors as `Connection.execute`.
        """
        row = self._run(connection, parameters, _fetch)
        return None if row is None else self._row(row)

    def count(self, connection: Connection, parameters: Mapping[str, Any]) -> int:
        """Executes the statement and returns the number of changed rows; arguments and exceptions as for `first`."""
        return int(self._run(connection, parameters, _count))

    def _run(self, connection: Connection, parameters: Mapping[str, Any], take: Callable[[Any], Any]) -> Any:
        if not connection.in_transaction():
            connection.begin()
        compiled_statement = self._compiled.get(connection.dialect.name) or self._compile(connection.dialect)
        values: Any = {**compiled_statement.fixed, **parameters}
        if compiled_statement.order is not None:
            values = [values[name] for name in compiled_statement.order]
        with closing(connection.connection.cursor()) as cursor:
            try:
                cursor.execute(compiled_statement.sql, values)
                return take(cursor)
            except connection.dialect.loaded_dbapi.Error as error:
                raise _translated(connection, cursor, compiled_statement.sql, values, error) from error

    def _compile(self, dialect: Dialect) -> _Compiled:
        compiled: Any = self.statement.compile(dialect=dialect, column_keys=_keys(self.statement))
        fixed = {name: bind.value for bind, name in compiled.bind_names.items() if not bind.required}
        plain = {name: str(value) if isinstance(value, str) else value for name, value in fixed.items()}
        compiled_statement = _Compiled(str(compiled), plain, compiled.positiontup)
        self._compiled[dialect.name] = compiled_statement
        return compiled_statement


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
    """Converts a driver error to SQLAlchemy's exception; a lost connection is invalidated and reopened at next use."""
    dialect = connection.dialect
    is_gone = dialect.is_disconnect(error, connection.connection.dbapi_connection, cursor)
    base = dialect.loaded_dbapi.Error
    raised = DBAPIError.instance(sql, values, error, base, connection_invalidated=is_gone, dialect=dialect)
    if is_gone:
        connection.invalidate(error)
    return raised
