"""History store: an SQLite file, or any database that SQLAlchemy supports."""

from __future__ import annotations

import sqlite3
from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from types import TracebackType
from typing import Any

from avrare.analysis.history.entry import FIELDS, HistoryEntry
from avrare.base.errors import PluginError, UsageError

DEFAULT = ".avrare/history.sqlite"
MOST_ENTRIES = 200_000
"""Entries that are read at once, some 300 MB."""
_TABLE = "avrare_history"
_COLUMN_TYPES = {"str": "VARCHAR(255)", "int": "BIGINT", "float": "DOUBLE PRECISION", "bool": "INTEGER"}
_LOCK_TIMEOUT = 30.0
"""Seconds to wait for another process that is writing."""


class HistoryStore:
    """History in a database; a context manager that commits at its end unless there was an error.

    ``url`` is the path of a file, or an SQLAlchemy URL; ``location`` is the same without a password.
    UsageError if it does not exist or cannot be opened, PluginError if SQLAlchemy or a driver is missing.
    """

    def __init__(self, url: str = DEFAULT, *, create: bool = False) -> None:
        self.location = _without_secrets(url)
        path = url.removeprefix("sqlite:///")
        self._connection: _SqliteConnection | _SqlAlchemyConnection = (
            _SqlAlchemyConnection(url) if "://" in path else _SqliteConnection(Path(path), create)
        )
        if create:
            columns = (f"{one.name} {_COLUMN_TYPES[str(one.type)]} NOT NULL" for one in fields(HistoryEntry))
            self._connection.create_table(
                f"CREATE TABLE IF NOT EXISTS {_TABLE} ({', '.join(columns)}, PRIMARY KEY (id))"
            )

    def __enter__(self) -> HistoryStore:
        return self

    def __exit__(self, kind: type[BaseException] | None, _: object, __: TracebackType | None) -> None:
        self._connection.close(commit=kind is None)

    def add(self, entries: Sequence[HistoryEntry]) -> int:
        """Add the entries that are not stored yet and return their number."""
        places = ", ".join(f":{name}" for name in FIELDS)
        statement = f"INSERT INTO {_TABLE} ({', '.join(FIELDS)}) VALUES ({places})"
        return sum(
            self._connection.insert(statement, vars(entry) | {"changed": int(entry.changed)})
            for entry in entries
            if not self._connection.run(f"SELECT id FROM {_TABLE} WHERE id = :id", {"id": entry.id})
        )

    def read(self, scenario: str | None = None) -> list[HistoryEntry]:
        """Return the entries of a scenario, or of all."""
        statement = f"SELECT {', '.join(FIELDS)} FROM {_TABLE}"
        if scenario is not None:
            statement += " WHERE scenario = :scenario"
        statement += f" LIMIT {MOST_ENTRIES + 1}"
        rows = self._connection.run(statement, {"scenario": scenario} if scenario is not None else {})
        if len(rows) > MOST_ENTRIES:
            text = f"{self.location}: more than {MOST_ENTRIES:,} entries"
            advice = "divide the history into several" if scenario else "name one of its scenarios"
            raise UsageError(text, f"{advice}: avrare history SCENARIO --store URL")
        return [self._entry(row) for row in rows]

    def _entry(self, row: Sequence[Any]) -> HistoryEntry:
        try:
            return HistoryEntry.from_row(row)
        except ValueError as error:
            reason = " ".join(str(error).split())[:200]
            text = f"{self.location}: entry {str(row[0])[:32]!r} is damaged: {reason}"
            raise UsageError(text, "restore the history, or add its runs to a new one") from None

    def scenarios(self) -> list[str]:
        """Return the names of all scenarios."""
        statement = f"SELECT DISTINCT scenario FROM {_TABLE} ORDER BY scenario"
        return [str(row[0]) for row in self._connection.run(statement, {})]


class _SqliteConnection:
    def __init__(self, path: Path, create: bool) -> None:
        self.path = path
        if not create and not path.is_file():
            raise UsageError(f"{path}: there is no history file", "avrare history add DIR creates one")
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._database = sqlite3.connect(path, timeout=_LOCK_TIMEOUT)
            if create:  # lock for writing now: what `add` looks up stays true until it inserts
                self._database.execute("BEGIN IMMEDIATE")
        except (OSError, sqlite3.Error) as error:
            raise UsageError(f"{path}: cannot open the history: {error}", "choose another --store") from None

    def run(self, statement: str, values: Mapping[str, Any]) -> Sequence[Sequence[Any]]:
        try:
            return self._database.execute(statement, dict(values)).fetchall()
        except (sqlite3.Error, UnicodeError, OverflowError) as error:
            raise UsageError(f"{self.path}: {error}", "is this a history file of avrare?") from None

    def create_table(self, statement: str) -> None:
        self.run(statement, {})

    def insert(self, statement: str, values: Mapping[str, Any]) -> bool:
        self.run(statement, values)
        return True

    def close(self, commit: bool) -> None:
        try:
            if commit:
                self._database.commit()
        except sqlite3.Error as error:
            problem = f"{self.path}: cannot write the history: {error}"
            raise UsageError(problem, "choose another --store") from None
        finally:
            self._database.close()


class _SqlAlchemyConnection:
    def __init__(self, url: str) -> None:
        self._place = f"--store {_without_secrets(url)}"
        try:
            import sqlalchemy
        except ImportError:
            raise PluginError(f"{self._place}: needs SQLAlchemy", "pip install 'avrare[history]'") from None
        self._text, self._error = sqlalchemy.text, sqlalchemy.exc.SQLAlchemyError
        self._duplicate = sqlalchemy.exc.IntegrityError
        timeout = {"timeout": _LOCK_TIMEOUT} if url.startswith("sqlite") else {}
        try:
            self._connection = sqlalchemy.create_engine(url, connect_args=timeout).connect()
        except ImportError as error:
            raise PluginError(f"{self._place}: {error}", "install the database's driver") from None
        except self._error as error:
            raise UsageError(f"{self._place}: {_first_line(error)}", "is the URL right?") from None

    def run(self, statement: str, values: Mapping[str, Any]) -> Sequence[Sequence[Any]]:
        try:
            found = self._connection.execute(self._text(statement), dict(values))
            return found.fetchall() if found.returns_rows else []
        except self._error as error:
            problem = f"{self._place}: {_first_line(error)}"
            raise UsageError(problem, "avrare history add DIR creates a history") from None

    def create_table(self, statement: str) -> None:
        try:
            self.run(statement, {})
            self._connection.commit()
        except (UsageError, self._error):  # of two processes that create it at once, one may fail
            self._connection.rollback()
            self.run(f"SELECT id FROM {_TABLE} WHERE 1 = 0", {})

    def insert(self, statement: str, values: Mapping[str, Any]) -> bool:
        try:
            with self._connection.begin_nested():
                self._connection.execute(self._text(statement), dict(values))
        except self._duplicate:  # another process has inserted the key meanwhile
            return False
        except self._error as error:
            raise self._write_error(error) from None
        return True

    def close(self, commit: bool) -> None:
        try:
            if commit:
                self._connection.commit()
        except self._error as error:
            raise self._write_error(error) from None
        finally:
            self._connection.close()

    def _write_error(self, error: Exception) -> UsageError:
        problem = f"{self._place}: cannot write the history: {_first_line(error)}"
        return UsageError(problem, "try again, or choose another --store")


def _without_secrets(url: str) -> str:
    # The user, the password and the options may each hold a secret.
    head, sep, rest = url.partition("://")
    return f"{head}{sep}{rest.rpartition('@')[2].partition('?')[0]}" if sep else url


def _first_line(error: Exception) -> str:
    return str(error).splitlines()[0]
