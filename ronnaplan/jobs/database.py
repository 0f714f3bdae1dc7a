"""A small SQLite database: plain SQL in, tuples or records out; what was committed is on the disk."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterable, Iterator
from contextlib import closing, contextmanager
from dataclasses import fields
from functools import cache
from pathlib import Path
from typing import Any, Self, TypeVar

from ronnaplan.errors import InputError

WAIT_S = 30.0
"""How long a writer waits for another one's transaction."""

Row = TypeVar("Row")


class Database:
    """One connection to the database in the file ``path``, whose tables ``schema`` makes; one thread at a time.

    Raises `InputError` where one of these tables is there with other columns.
    """

    def __init__(self, path: Path, schema: str) -> None:
        self._connection = sqlite3.connect(path, timeout=WAIT_S, isolation_level=None, check_same_thread=False)
        try:
            self._connection.execute("PRAGMA journal_mode = WAL")
            self._connection.execute("PRAGMA synchronous = FULL")
            self._connection.execute("PRAGMA fullfsync = ON")  # as `portable.sync` does on macOS
            self._connection.execute("PRAGMA foreign_keys = ON")
            _require_columns(self._connection, path, schema)
            self._connection.executescript(schema)
        except (sqlite3.Error, InputError):  # no database, a full disk, or of another version
            self.close()
            raise

    def close(self) -> None:
        """Let go of the file."""
        self._connection.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @contextmanager
    def transaction(self) -> Iterator[None]:
        """All that is done within is kept, on the disk, or none of it."""
        self._connection.execute("BEGIN IMMEDIATE")
        try:
            yield
            self._connection.execute("COMMIT")
        except BaseException:
            if self._connection.in_transaction:  # a disk that is full may have ended it
                self._connection.execute("ROLLBACK")
            raise

    def run(self, sql: str, *values: Any) -> int:
        """Execute a statement; returns how many rows it changed."""
        with closing(self._connection.execute(sql, values)) as cursor:
            return cursor.rowcount

    def run_many(self, sql: str, values: Iterable[tuple[Any, ...]]) -> None:
        """Execute a statement once for each row of ``values``."""
        self._connection.executemany(sql, values).close()

    def rows(self, sql: str, *values: Any) -> list[tuple[Any, ...]]:
        """Return all rows of a query."""
        return list(self.each(sql, *values))

    def each(self, sql: str, *values: Any) -> Iterator[tuple[Any, ...]]:
        """Yield the rows of a query one by one; nothing may be changed that it reads meanwhile."""
        with closing(self._connection.execute(sql, values)) as cursor:
            yield from cursor

    def records(self, kind: type[Row], rest: str, *values: Any) -> list[Row]:
        """Return rows as records of ``kind``, whose fields are the columns; ``rest`` begins with FROM."""
        columns = ", ".join(one.name for one in fields(kind))  # type: ignore[arg-type]
        return [kind(*row) for row in self.rows(f"SELECT {columns} {rest}", *values)]

    def value(self, sql: str, *values: Any) -> Any:
        """Return the first column of the first row; None without one."""
        found = self.rows(sql, *values)
        return found[0][0] if found else None


def _require_columns(connection: sqlite3.Connection, path: Path, schema: str) -> None:
    expected, found = _columns_of(schema), _columns(connection)
    for table in expected.keys() & found.keys():
        if unlike := expected[table] ^ found[table]:
            raise InputError(
                f"{path} was made by another version of ronnaplan: its table {table} differs in "
                f"{', '.join(sorted(unlike))}; name another folder"
            )


@cache
def _columns_of(schema: str) -> dict[str, set[str]]:
    with closing(sqlite3.connect(":memory:")) as made:
        made.executescript(schema)
        return _columns(made)


def _columns(connection: sqlite3.Connection) -> dict[str, set[str]]:
    """Return the columns of each table."""
    tables = [name for (name,) in connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")]
    query = "SELECT name FROM pragma_table_info(?)"
    return {table: {name for (name,) in connection.execute(query, (table,))} for table in tables}
