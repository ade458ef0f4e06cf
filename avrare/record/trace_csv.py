"""Recordings from CSV files: named signals, or vehicles with one row for each vehicle and sample."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from avrare.driving import Road
from avrare.errors import UsageError, did_you_mean
from avrare.record.trace import FIELDS, Recording, Track, assemble
from avrare.record.trace_table import Table, read_table, steady_step

COLUMNS = ("vehicle", "x", "y", "heading", "speed", "length", "width")
"""What a file of vehicles has beside the time; ``acceleration`` is optional."""

_ALIASES = ("vehicleid", "id", "trackid", "objectid", "carid", "name", "vehicles", "car", "track", "object")
"""What others call the column ``vehicle``, without regard to case, ``_`` and ``-``."""

_OFF_GRID = 0.25
"""Share of a step by which a row may lie beside the sample that it belongs to."""

_MOST_TURNS = 4 * math.pi
"""A heading beyond two full turns is in degrees."""


def read_csv(path: str, ego: str = "ego", road: Road | None = None) -> Recording:
    """Read a recorded drive.

    A file with a column ``vehicle`` holds vehicles, any other named signals.

    Args:
        path: The file.
        ego: Name of the vehicle that rules are for.
        road: Lanes, for rules.

    Raises:
        UsageError: With file and line of what is wrong.
    """
    table = read_table(path)
    if "vehicle" in table.names or _speaks_of_vehicles(table):
        return _vehicles(table, ego, road)
    return _signals(table)


def _speaks_of_vehicles(table: Table) -> bool:
    """Whether a file without a column ``vehicle`` must be meant to have one: two of three signs say so."""
    if not {"x", "y"} <= set(table.names):
        return False
    column = table.names.index(table.time)
    times = [cells[column] for _, cells in table.rows]
    complete, again = set(COLUMNS[1:]) <= set(table.names), len(set(times)) < len(times)
    return complete + again + (_alias(table) is not None) >= 2


def _alias(table: Table) -> str | None:
    """The column that names the vehicles in other formats."""
    plain = {name.lower().replace("_", "").replace("-", ""): name for name in table.names}
    return next((plain[word] for word in _ALIASES if word in plain), None)


def _signals(table: Table) -> Recording:
    times = np.array([table.finite(row, table.time) for row in range(len(table.rows))])
    columns = {name: table.numbers(name) for name in table.names if name != table.time}
    dt = steady_step(table, times, range(len(times)))
    if not columns:
        raise UsageError(f"{table.path}:1: there is no signal beside the time")
    return Recording(table.path, dt, float(times[0]), columns)


def _vehicles(table: Table, ego: str, road: Road | None) -> Recording:
    _check_columns(table)
    rows = _rows_by_vehicle(table)
    if ego not in rows:
        names = ", ".join(sorted(rows)[:12])
        hint = did_you_mean(ego, rows) if len(rows) > 12 else f"choose it with --ego; there are: {names}"
        raise UsageError(f"{table.path}: no vehicle is called {ego!r}", hint)
    times = np.array([table.finite(row, table.time) for row in rows[ego]])
    dt = steady_step(table, times, rows[ego])
    start, samples = float(times[0]), len(times)
    tracks = {name: _track(table, name, found, start, dt, samples) for name, found in rows.items()}
    others = [track for name, track in tracks.items() if name != ego and track.present.any()]
    return assemble(table.path, dt, start, tracks[ego], others, road)


def _check_columns(table: Table) -> None:
    missing = [repr(name) for name in COLUMNS if name not in table.names]
    if missing:
        words = f"column {missing[0]} is" if len(missing) == 1 else f"columns {', '.join(missing)} are"
        alias = None if "vehicle" in table.names else _alias(table)
        hint = f"vehicles have the columns time, {', '.join(COLUMNS)} and, if known, acceleration"
        if alias is not None:
            hint = f"call the column vehicle in place of {alias}" + (f"; {hint}" if len(missing) > 1 else "")
        raise UsageError(f"{table.path}:1: {words} missing", hint)


def _rows_by_vehicle(table: Table) -> dict[str, list[int]]:
    """Vehicle -> its rows, in the file's order."""
    column = table.names.index("vehicle")
    rows: dict[str, list[int]] = {}
    seen: dict[tuple[str, float], int] = {}
    for row, (line, cells) in enumerate(table.rows):
        name, time = cells[column], table.finite(row, table.time)
        if not name:
            raise UsageError(f"{table.path}:{line}: vehicle: the cell is empty")
        if (name, time) in seen:
            before = table.rows[seen[name, time]][0]
            text = f"{name!r} has a second row at {time:g} s"
            raise UsageError(f"{table.path}:{line}: vehicle: {text}", f"the first is on line {before}")
        seen[name, time] = row
        rows.setdefault(name, []).append(row)
    return rows


def _track(table: Table, name: str, rows: Sequence[int], start: float, dt: float, samples: int) -> Track:
    """The rows of one vehicle on the ego's samples."""
    present, states = np.zeros(samples, dtype=bool), np.full((len(FIELDS), samples), np.nan)
    for row in rows:
        exact = (table.finite(row, table.time) - start) / dt
        k = round(exact)
        if not 0 <= k < samples:
            continue
        if abs(exact - k) > _OFF_GRID:
            text = f"{name!r} at {table.finite(row, table.time):g} s lies between two samples of the ego"
            raise UsageError(f"{table.path}:{table.rows[row][0]}: {table.time}: {text}", "resample the trace")
        present[k] = True
        states[:, k] = _state(table, row)
    length, width = (_size(table, name, rows, key) for key in ("length", "width"))
    return Track(name, length, width, present, states)


def _state(table: Table, row: int) -> list[float]:
    """x, y, heading, speed and acceleration; the latter NaN where it was not recorded."""
    line, cells = table.rows[row]
    values = [table.finite(row, field) for field in FIELDS[:4]]
    if abs(values[2]) > _MOST_TURNS:
        hint = "headings are in radians, counter-clockwise from the direction of the road"
        raise UsageError(f"{table.path}:{line}: heading: {values[2]:g} is more than two turns", hint)
    recorded = "acceleration" in table.names and cells[table.names.index("acceleration")]
    return [*values, table.finite(row, "acceleration") if recorded else math.nan]


def _size(table: Table, name: str, rows: Sequence[int], key: str) -> float:
    first = table.finite(rows[0], key)
    for row in rows:
        value, line = table.finite(row, key), table.rows[row][0]
        if value <= 0.0:
            raise UsageError(f"{table.path}:{line}: {key}: should be above zero, found {value:g}")
        if value != first:
            raise UsageError(f"{table.path}:{line}: {key}: {name!r} changes from {first:g} to {value:g} m")
    return first
