"""Where a history lies: an SQLite file by the standard library, or any database that SQLAlchemy knows."""

from __future__ import annotations

import sqlite3
from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from types import TracebackType
from typing import Any, Protocol

from avrare.errors import PluginError, UsageError
from avrare.history.entry import Entry

DEFAULT = ".avrare/history.sqlite"
_TABLE = "avrare_history"
_KINDS = {"str": "VARCHAR(255)", "int": "BIGINT", "float": "DOUBLE PRECISION", "bool": "INTEGER"}
_PATIENCE = 30.0
"""Seconds to wait for another job that is writing."""


class Connection(Protocol):
    """What a history needs of a database; statements have ``:name`` parameters."""

    def run(self, statement: str, values: Mapping[str, Any]) -> Sequence[Sequence[Any]]:
        """The rows of a query, nothing of another statement."""

    def make(self, table: str, statement: str) -> None:
        """Make a table by a statement, unless it is there."""

    def insert(self, statement: str, values: Mapping[str, Any]) -> bool:
        """Insert a row; False where another job has inserted its key meanwhile."""

    def close(self, keep: bool) -> None:
        """Commit or roll back, and let go."""


class Store:
    """A history in a database; a context manager, whose end keeps what was added unless there was an error.

    Args:
        url: A file's path, or an SQLAlchemy URL.
        create: Begin one where there is none.

    Attributes:
        place: The file or the URL, without a password.

    Raises:
        UsageError: There is none, or it cannot be opened.
        PluginError: SQLAlchemy or a driver is missing.
    """

    def __init__(self, url: str = DEFAULT, *, create: bool = False) -> None:
        self.place = _shown(url)
        self._connection = _connect(url, create)
        if create:
            columns = ", ".join(f"{one.name} {_KINDS[str(one.type)]} NOT NULL" for one in fields(Entry))
            statement = f"CREATE TABLE IF NOT EXISTS {_TABLE} ({columns}, PRIMARY KEY (id))"
            self._connection.make(_TABLE, statement)

    def __enter__(self) -> Store:
        return self

    def __exit__(self, kind: type[BaseException] | None, _: object, __: TracebackType | None) -> None:
        self._connection.close(keep=kind is None)

    def add(self, entries: Sequence[Entry]) -> int:
        """Add what is not there yet; how many that was."""
        names = [one.name for one in fields(Entry)]
        places = ", ".join(f":{name}" for name in names)
        added = 0
        for entry in entries:
            if self._run(f"SELECT id FROM {_TABLE} WHERE id = :id", id=entry.id):
                continue
            values = entry.to_dict() | {"changed": int(entry.changed)}
            statement = f"INSERT INTO {_TABLE} ({', '.join(names)}) VALUES ({places})"
            added += self._connection.insert(statement, values)
        return added

    def read(self, scenario: str | None = None, specification: str | None = None) -> list[Entry]:
        """The entries of a scenario and a specification, or of all of them."""
        wanted = {"scenario": scenario, "specification": specification}
        chosen = {name: value for name, value in wanted.items() if value is not None}
        where = " AND ".join(f"{name} = :{name}" for name in chosen)
        names = [one.name for one in fields(Entry)]
        statement = f"SELECT {', '.join(names)} FROM {_TABLE}" + (f" WHERE {where}" if where else "")
        rows = [dict(zip(names, row, strict=True)) for row in self._run(statement, **chosen)]
        return [Entry(**{**row, "changed": bool(row["changed"])}) for row in rows]

    def scenarios(self) -> list[str]:
        """Their names."""
        return [str(row[0]) for row in self._run(f"SELECT DISTINCT scenario FROM {_TABLE} ORDER BY scenario")]

    def _run(self, statement: str, **values: Any) -> Sequence[Sequence[Any]]:
        return self._connection.run(statement, values)


def _connect(url: str, create: bool) -> Connection:
    path = url.removeprefix("sqlite:///")
    if "://" in path:
        return _Alchemy(url)
    return _File(Path(path), create)


class _File:
    """An SQLite file."""

    def __init__(self, path: Path, create: bool) -> None:
        self.path = path
        if not create and not path.is_file():
            raise UsageError(f"{path}: there is no history here", "avrare history add DIR begins one")
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._database = sqlite3.connect(path, timeout=_PATIENCE)
            if create:  # what is looked up stays true until it is written: jobs add one after another
                self._database.execute("BEGIN IMMEDIATE")
        except (OSError, sqlite3.Error) as error:
            raise UsageError(f"{path}: cannot be opened: {error}", "choose another --store") from None

    def run(self, statement: str, values: Mapping[str, Any]) -> Sequence[Sequence[Any]]:
        """See ``Connection``."""
        try:
            return self._database.execute(statement, dict(values)).fetchall()
        except sqlite3.Error as error:
            raise UsageError(f"{self.path}: {error}", "is this a history of avrare?") from None

    def make(self, table: str, statement: str) -> None:
        """See ``Connection``; nobody else writes since the file was opened."""
        self.run(statement, {})

    def insert(self, statement: str, values: Mapping[str, Any]) -> bool:
        """See ``Connection``; nobody else writes since the file was opened."""
        self.run(statement, values)
        return True

    def close(self, keep: bool) -> None:
        """See ``Connection``."""
        try:
            if keep:
                self._database.commit()
        except sqlite3.Error as error:
            raise UsageError(f"{self.path}: cannot be written: {error}", "choose another --store") from None
        finally:
            self._database.close()


class _Alchemy:
    """A database that SQLAlchemy knows."""

    def __init__(self, url: str) -> None:
        try:
            import sqlalchemy
        except ImportError:
            problem = f"--store {_shown(url)}: needs SQLAlchemy"
            raise PluginError(problem, "pip install 'avrare[history]'") from None
        self._text, self._error = sqlalchemy.text, sqlalchemy.exc.SQLAlchemyError
        self._taken = sqlalchemy.exc.IntegrityError
        self._shown = _shown(url)
        patience = {"timeout": _PATIENCE} if url.startswith("sqlite") else {}
        try:
            self._connection = sqlalchemy.create_engine(url, connect_args=patience).connect()
        except ImportError as error:
            raise PluginError(f"--store {self._shown}: {error}", "install the database's driver") from None
        except self._error as error:
            raise UsageError(f"--store {self._shown}: {_first(error)}", "is the URL right?") from None

    def run(self, statement: str, values: Mapping[str, Any]) -> Sequence[Sequence[Any]]:
        """See ``Connection``."""
        try:
            found = self._connection.execute(self._text(statement), dict(values))
            return found.fetchall() if found.returns_rows else []
        except self._error as error:
            problem = f"--store {self._shown}: {_first(error)}"
            raise UsageError(problem, "avrare history add DIR begins a history") from None

    def make(self, table: str, statement: str) -> None:
        """See ``Connection``; where two jobs make it at once, ``IF NOT EXISTS`` may fail in one of them."""
        try:
            self.run(statement, {})
            self._connection.commit()
        except (UsageError, self._error):
            self._connection.rollback()
            self.run(f"SELECT id FROM {table} WHERE 1 = 0", {})

    def insert(self, statement: str, values: Mapping[str, Any]) -> bool:
        """See ``Connection``."""
        try:
            with self._connection.begin_nested():
                self._connection.execute(self._text(statement), dict(values))
        except self._taken:
            return False
        except self._error as error:
            problem = f"--store {self._shown}: cannot be written: {_first(error)}"
            raise UsageError(problem, "try again, or choose another --store") from None
        return True

    def close(self, keep: bool) -> None:
        """See ``Connection``."""
        try:
            if keep:
                self._connection.commit()
        except self._error as error:
            problem = f"--store {self._shown}: cannot be written: {_first(error)}"
            raise UsageError(problem, "try again, or choose another --store") from None
        finally:
            self._connection.close()


def _shown(url: str) -> str:
    """The URL without user, password and options, any of which may hold a secret."""
    head, sep, rest = url.partition("://")
    return f"{head}{sep}{rest.rpartition('@')[2].partition('?')[0]}" if sep else url


def _first(error: Exception) -> str:
    return str(error).splitlines()[0]
