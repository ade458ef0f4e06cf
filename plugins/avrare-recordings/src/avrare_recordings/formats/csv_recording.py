"""Recordings in CSV files: named signals, or vehicles with one row for each vehicle and sample."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import count

import numpy as np

from avrare.base.csv_table import CsvTable, read_csv_table
from avrare.base.errors import UsageError, did_you_mean
from avrare.base.visible_text import escape_cell
from avrare.driving import Road
from avrare.protocols import Floats
from avrare.results.recordings import FIELDS, Recording, VehicleTrack, assemble_recording
from avrare.rollout.replay import tabulate_signals

VEHICLE_COLUMNS = ("vehicle", "x", "y", "heading", "speed", "length", "width")
"""Columns of a file of vehicles in addition to the time; ``acceleration`` is optional."""

_EGO = "ego"
_ALIASES = ("vehicleid", "id", "trackid", "objectid", "carid", "name", "vehicles", "car", "track", "object")
"""Names of the column ``vehicle`` in other formats, ignoring case, ``_`` and ``-``."""


def read_csv(path: str, ego: str = _EGO, road: Road | None = None) -> Recording:
    """Read a recorded drive: of vehicles if the file has a column ``vehicle``, otherwise of named signals.

    Rules apply to the vehicle called ``ego`` and need a road. Errors in the file name the line.
    """
    table = read_csv_table(
        path,
        missing="give the file of a recorded drive",
        empty="the first line names the columns: time,speed,gap",
    )
    _check_header(table)
    table.check_rows()
    if "vehicle" in table.names or _looks_like_vehicles(table):
        return _read_vehicles(table, road).recording(ego)
    return _read_signals(table)


def open_csv(path: str, road: Road | None = None) -> CsvDrives:
    """Read a file of vehicles once, for any number of egos."""
    table = read_csv_table(path, empty="the first line names the columns: time,vehicle,x,y")
    _check_header(table)
    table.check_rows()
    return _read_vehicles(table, road)


def to_csv(recording: Recording) -> str:
    """Return the text of a CSV file that ``read_csv`` reads back to the last bit.

    With a road it has a row for each vehicle and sample: the ego is called ``ego``, the others as
    ``csv_vehicle_names`` says. Without one it has named signals.
    """
    scene = recording.scene
    if scene is None:
        columns, values = tabulate_signals(recording.signals)
        plain = (escape_cell(name.replace("[", "_").replace("]", "").replace(",", "_")) for name in columns)
        lines = [["time", *plain]]
        lines += [[_format(recording.time(t)), *map(_format, values[t])] for t in range(recording.samples)]
    else:
        lines = [["time", "vehicle", *FIELDS[:4], "length", "width", FIELDS[4]]]
        names = (_EGO, *csv_vehicle_names(scene.names))
        lengths, widths = (scene.ego_length, *scene.lengths), (scene.ego_width, *scene.widths)
        ego, others = (
            np.stack([recording.signals[f"{who}_{field}"] for field in FIELDS]) for who in ("ego", "others")
        )
        states = np.concatenate([ego[..., None], others], axis=-1)  # (fields, T, vehicles)
        for t, v in np.ndindex(states.shape[1:]):
            numbers = [*states[:4, t, v], lengths[v], widths[v], states[4, t, v]]
            lines.append([_format(recording.time(t)), names[v], *map(_format, numbers)])
    content = io.StringIO()
    csv.writer(content, lineterminator="\n").writerows(lines)  # names of vehicles may contain commas
    return content.getvalue()


def csv_vehicle_names(names: Sequence[str]) -> tuple[str, ...]:
    """Return the names of the other vehicles in a CSV file.

    They are unchanged, except for one called ``ego`` and those that a spreadsheet or a terminal would obey.
    """
    free = (f"{_EGO}_{number}" for number in count(2))
    return tuple(
        next(candidate for candidate in free if candidate not in names) if name == _EGO else escape_cell(name)
        for name in names
    )


def _format(value: float) -> str:
    return repr(float(value))


def _check_header(table: CsvTable) -> None:
    names = table.names
    for sign, word in ((";", "semicolons"), ("\t", "tabs")):
        if len(names) == 1 and sign in names[0]:
            text = f"{table.header}: the columns are separated by {word}"
            raise UsageError(text, "separate them by commas, with a point in decimal numbers")
    for place, name in enumerate(names):
        if not name:
            raise UsageError(f"{table.header}: column {place + 1} has no name")
        if name in names[:place]:
            raise UsageError(f"{table.header}: two columns are called {name!r}")


def _find_time_column(table: CsvTable) -> str:
    for name in ("time", "t"):
        if name in table.names:
            return name
    hint = f"give every row its time in seconds; the columns are {', '.join(table.names)}"
    raise UsageError(f"{table.path}:1: there is no column 'time' or 't'", hint)


def _looks_like_vehicles(table: CsvTable) -> bool:
    # Two of three signs say that the column ``vehicle`` has been forgotten.
    if not {"x", "y"} <= set(table.names):
        return False
    column = table.names.index(_find_time_column(table))
    times = [cells[column] for _, cells in table.rows]
    complete, repeated = set(VEHICLE_COLUMNS[1:]) <= set(table.names), len(set(times)) < len(times)
    return complete + repeated + (_find_alias(table) is not None) >= 2


def _find_alias(table: CsvTable) -> str | None:
    plain = {name.lower().replace("_", "").replace("-", ""): name for name in table.names}
    return next((plain[alias] for alias in _ALIASES if alias in plain), None)


def _read_signals(table: CsvTable) -> Recording:
    clock = _find_time_column(table)
    rows, names = range(len(table.rows)), [name for name in table.names if name != clock]
    times = np.array([table.finite(row, clock) for row in rows])
    signals = {name: np.array([table.number(row, name) for row in rows]) for name in names}
    dt = _find_step(table, times, rows)
    if not signals:
        raise UsageError(f"{table.path}:1: there is no signal column besides the time")
    return Recording(table.path, dt, float(times[0]), signals)


def _read_vehicles(table: CsvTable, road: Road | None) -> CsvDrives:
    _check_vehicle_columns(table)
    clock = _find_time_column(table)
    vehicles = {}
    for name, rows in _group_rows_by_vehicle(table).items():
        times = np.array([table.finite(row, clock) for row in rows])
        states = np.array([_read_state(table, row) for row in rows]).T
        sizes = [_read_size(table, name, rows, key) for key in ("length", "width")]
        vehicles[name] = _VehicleRows(name, tuple(rows), times, states, sizes[0], sizes[1])
    return CsvDrives(table, vehicles, road)


@dataclass(frozen=True)
class _VehicleRows:
    name: str
    rows: tuple[int, ...]
    times: Floats
    states: Floats  # (5, K)
    length: float
    width: float


@dataclass(frozen=True)
class CsvDrives:
    """File of vehicles, any of which can be the ego.

    Attributes:
        table: The file.
        vehicles: Its rows by vehicle.
        road: Road, or None.
    """

    table: CsvTable
    vehicles: Mapping[str, _VehicleRows]
    road: Road | None

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the vehicles."""
        return tuple(self.vehicles)

    def recording(self, ego: str) -> Recording:
        """Return the drive of one ego; UsageError if it is not there or its samples are not regular."""
        table = self.table
        if ego not in self.vehicles:
            names = ", ".join(sorted(self.vehicles)[:12])
            many = len(self.vehicles) > 12
            hint = did_you_mean(ego, self.vehicles) if many else f"choose the ego; there are: {names}"
            raise UsageError(f"{table.path}: no vehicle is called {ego!r}", hint)
        ego_rows = self.vehicles[ego]
        dt = _find_step(table, ego_rows.times, ego_rows.rows)
        start, samples = float(ego_rows.times[0]), len(ego_rows.times)
        tracks = {name: _place(table, rows, start, dt, samples) for name, rows in self.vehicles.items()}
        others = [track for name, track in tracks.items() if name != ego and track.present.any()]
        return assemble_recording(table.path, dt, start, tracks[ego], others, self.road)


def _check_vehicle_columns(table: CsvTable) -> None:
    missing = [repr(name) for name in VEHICLE_COLUMNS if name not in table.names]
    if not missing:
        return
    subject = f"column {missing[0]} is" if len(missing) == 1 else f"columns {', '.join(missing)} are"
    alias = None if "vehicle" in table.names else _find_alias(table)
    hint = f"vehicles have the columns time, {', '.join(VEHICLE_COLUMNS)} and, if known, acceleration"
    if alias is not None:
        hint = f"rename the column {alias} to vehicle" + (f"; {hint}" if len(missing) > 1 else "")
    raise UsageError(f"{table.path}:1: {subject} missing", hint)


def _group_rows_by_vehicle(table: CsvTable) -> dict[str, list[int]]:
    clock = _find_time_column(table)
    rows: dict[str, list[int]] = {}
    seen: dict[tuple[str, float], int] = {}
    for row in range(len(table.rows)):
        name, time = table.cell(row, "vehicle"), table.finite(row, clock)
        where = table.position(row, "vehicle")
        if not name:
            raise UsageError(f"{where}: the cell is empty")
        if (name, time) in seen:
            text = f"{where}: {name!r} has a second row at {time:g} s"
            raise UsageError(text, f"the first is on line {table.rows[seen[name, time]][0]}")
        seen[name, time] = row
        rows.setdefault(name, []).append(row)
    return rows


def _place(table: CsvTable, vehicle: _VehicleRows, start: float, dt: float, samples: int) -> VehicleTrack:
    # on the samples of the ego
    present, states = np.zeros(samples, dtype=bool), np.full((len(FIELDS), samples), np.nan)
    with np.errstate(over="ignore"):
        exact = (vehicle.times - start) / dt
    near = np.flatnonzero((exact > -1.0) & (exact < samples))  # of any size, even infinite
    at = np.rint(exact[near]).astype(np.int64)
    near, at = near[(at >= 0) & (at < samples)], at[(at >= 0) & (at < samples)]
    for row in near[np.abs(exact[near] - at) > 0.25][:1]:  # of a step
        text = f"{vehicle.name!r} at {vehicle.times[row]:g} s lies between two samples of the ego"
        where = table.position(vehicle.rows[row], _find_time_column(table))
        raise UsageError(f"{where}: {text}", "resample the recording")
    present[at] = True
    states[:, at] = vehicle.states[:, near]
    return VehicleTrack(vehicle.name, vehicle.length, vehicle.width, present, states)


def _read_state(table: CsvTable, row: int) -> list[float]:
    values = [table.finite(row, field) for field in FIELDS[:4]]
    if abs(values[2]) > 4 * math.pi:  # beyond two full turns it is taken for degrees
        hint = "headings are in radians, counter-clockwise from the direction of the road"
        raise UsageError(f"{table.position(row, 'heading')}: {values[2]:g} is more than two turns", hint)
    recorded = "acceleration" in table.names and table.cell(row, "acceleration")
    return [*values, table.finite(row, "acceleration") if recorded else math.nan]


def _read_size(table: CsvTable, name: str, rows: Sequence[int], key: str) -> float:
    first = table.finite(rows[0], key)
    for row in rows:
        value = table.finite(row, key)
        if value <= 0.0:
            raise UsageError(f"{table.position(row, key)}: should be above zero, found {value:g}")
        if value != first:
            text = f"{name!r} changes from {first:g} to {value:g} m"
            raise UsageError(f"{table.position(row, key)}: {text}")
    return first


def _find_step(table: CsvTable, times: Floats, rows: Sequence[int]) -> float:
    if len(times) < 2:
        raise UsageError(f"{table.path}: there is only one sample", "the step is the time between samples")
    with np.errstate(over="ignore"):
        steps = np.diff(times)
    usual = float(np.quantile(steps, 0.5, method="lower"))  # a gap is larger than a step
    wrong = np.flatnonzero(steps <= 0.0)
    if not len(wrong):
        with np.errstate(invalid="ignore"):  # infinite steps: told below
            wrong = np.flatnonzero(np.abs(steps - usual) > 0.05 * usual)
    if len(wrong):
        k = int(wrong[0])
        where = table.position(rows[k + 1], _find_time_column(table))
        if steps[k] == 0.0:
            first = table.rows[rows[k]][0]
            raise UsageError(f"{where}: {times[k]:g} s occurs twice", f"the first time is on line {first}")
        if steps[k] < 0.0:
            raise UsageError(f"{where}: goes back from {times[k]:g} s to {times[k + 1]:g} s", "sort by time")
        text = f"{times[k + 1]:g} s is {steps[k]:.4g} s after the sample before, others {usual:.4g} s"
        raise UsageError(f"{where}: {text}", "a recording has one step throughout: resample it, or split it")
    step = round((float(times[-1]) - float(times[0])) / len(steps), 9)  # nanoseconds
    if not 0.0 < step < math.inf:
        text = f"{table.path}: a step is {usual:g} s"
        raise UsageError(text, "give the time in seconds; a step has at least a nanosecond")
    return step
