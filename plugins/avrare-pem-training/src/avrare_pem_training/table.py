"""CSV table of annotated vehicles and detections, the input of ``avrare pem fit``.

One line per annotated vehicle and frame, in the order of recording, with a header that names the columns:

* ``right, forward`` [m], ``yaw`` [rad, counter-clockwise from right; straight ahead and aligned: pi/2]: pose
  of the centre of the annotated box in the frame of the ego;
* ``length, width`` [m], and if known ``height`` [m], 1.7 where empty;
* ``visibility``, if known: 1 (below 40 % in view), 2 (40-60), 3 (60-80), 4 (80-100), 4 where empty;
* ``detected``: 0 or 1;
* ``error_right, error_forward`` [m] and if known ``error_yaw`` [rad]: truth minus detection, empty where
  missed; or, instead, the detected box itself: ``detected_right, detected_forward, detected_yaw``;
* if known, ``track``, a number for each vehicle, and ``time`` [s]: they tell how long errors last;
* if known, ``ghost``: 1 for a detection without a vehicle. Its row needs a place, ``right, forward``
  or ``detected_right, detected_forward``, and all rows a ``time``, equal for those of one frame. Its
  ``track`` gives its duration; its other columns are not read.
"""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass, fields
from difflib import get_close_matches
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from avrare.base.csv_table import read_csv_table
from avrare.base.errors import UsageError
from avrare.protocols import Bools, Floats
from avrare_gp_pem.runtime.features import Box
from avrare_pem_training.ghost_log import GhostLog

BOX = ("right", "forward", "yaw", "length", "width", "height", "visibility")
ERRORS = ("error_right", "error_forward", "error_yaw")
_DETECTED_BOX = ("detected_right", "detected_forward", "detected_yaw")
_REQUIRED = ("right", "forward", "yaw", "length", "width", "detected")
_DEFAULTS = {"height": 1.7, "visibility": 4.0}
_TRACK = ("track", "time")
_GHOST = "ghost"
_LIMITS = {  # lowest, highest, and the guess at a value beyond them
    "right": (-1000.0, 1000.0, "metres in the frame of the ego, not of a map and not centimetres?"),
    "forward": (-1000.0, 1000.0, "metres in the frame of the ego, not of a map and not centimetres?"),
    "yaw": (-13.0, 13.0, "radians, not degrees?"),
    "length": (0.1, 40.0, "metres?"),
    "width": (0.1, 10.0, "metres?"),
    "height": (0.1, 10.0, "metres?"),
    "visibility": (1.0, 4.0, "a category from 1 to 4?"),
    "detected": (0.0, 1.0, "0 or 1?"),
    "error_right": (-100.0, 100.0, "metres? leave it empty where the vehicle was missed"),
    "error_forward": (-100.0, 100.0, "metres? leave it empty where the vehicle was missed"),
    "error_yaw": (-13.0, 13.0, "radians, not degrees?"),
    "track": (0.0, 1e15, "a number for each vehicle, 0 or more?"),
    "time": (-1e11, 1e11, "seconds?"),
}


@dataclass(frozen=True)
class DetectionTable(Box):
    """Annotated vehicles and their detections, each field (n,).

    Attributes:
        detected: True for a detected vehicle.
        error_right: Truth minus detection [m]; NaN where missed.
        error_forward: Truth minus detection [m]; NaN where missed.
        error_yaw: Truth minus detection [rad]; NaN where missed or unknown.
        track: Number of the vehicle; NaN where unknown.
        time: Time of the frame [s], comparable within a track; NaN where unknown.
    """

    detected: Bools
    error_right: Floats
    error_forward: Floats
    error_yaw: Floats
    track: Floats
    time: Floats

    def __len__(self) -> int:
        return len(self.right)

    def take(self, index: Bools | NDArray[np.intp] | slice) -> DetectionTable:
        """Select rows."""
        return DetectionTable(**{column.name: getattr(self, column.name)[index] for column in fields(self)})


def errors_in(frame: str, rows: DetectionTable) -> Floats:
    """Return (n, 2) errors [m] along and across the vehicle ("vehicle"), or right and forward ("ego")."""
    if frame == "ego":
        return np.stack([rows.error_right, rows.error_forward], axis=-1)
    cos, sin = np.cos(rows.yaw), np.sin(rows.yaw)
    along = cos * rows.error_right + sin * rows.error_forward
    return np.stack([along, cos * rows.error_forward - sin * rows.error_right], axis=-1)


def make_table(columns: dict[str, Floats]) -> DetectionTable:
    """Create a table of columns; missed vehicles get no errors, missing numbers their defaults."""
    count = len(columns["right"])
    detected = columns["detected"] == 1
    full = {name: np.full(count, value) for name, value in _DEFAULTS.items()} | columns
    for name, value in _DEFAULTS.items():
        full[name] = np.where(np.isnan(full[name]), value, full[name])
    unknown = np.full(count, np.nan)
    errors = {name: np.where(detected, full.get(name, unknown), np.nan) for name in ERRORS}
    tracks = {name: full.get(name, unknown) for name in _TRACK}
    return DetectionTable(detected=detected, **{name: full[name] for name in BOX}, **errors, **tracks)


def read_table(path: Path) -> DetectionTable:
    """Read the annotated vehicles of a CSV file; see ``read_log``."""
    return read_log(path)[0]


def read_log(path: Path) -> tuple[DetectionTable, GhostLog | None]:
    """Read a CSV file, whose columns the module describes: vehicles, and false detections if there are any.

    Raises:
        UsageError: The file cannot be read, lacks a column, or holds an implausible value; the message gives
            file and line.
    """
    content = read_csv_table(
        path,
        missing="avrare pem convert writes one from two text files",
        empty=f"first line: {','.join((*BOX, 'detected', *ERRORS))}",
    )
    names = [name.lower() for name in content.names]
    _check_header(names, content.header)
    content.check_rows()
    known_names = {*BOX, *ERRORS, *_DETECTED_BOX, *_TRACK, _GHOST, "detected"}
    columns = {
        name: content.parse_column(given)
        for name, given in zip(names, content.names, strict=True)
        if name in known_names
    }
    lines = np.array([line for line, _ in content.rows])
    ghosts = _split_ghosts(path, columns, lines)
    if ghosts is not None:
        vehicles = ~(columns[_GHOST] == 1)
        columns = {name: part[vehicles] for name, part in columns.items()}
        lines = lines[vehicles]
    columns |= _errors_of_boxes(columns)
    check_values(path, columns, lines.tolist())
    return make_table(columns), ghosts


def _split_ghosts(path: Path, columns: dict[str, Floats], lines: NDArray[np.intp]) -> GhostLog | None:
    marks = columns.get(_GHOST)
    if marks is None:
        return None
    wrong = ~np.isnan(marks) & (marks != 0) & (marks != 1)
    _refuse(path, lines, wrong, "ghost: is implausible: 0 or 1?")
    false = marks == 1
    if not false.any():
        return None
    unknown = np.full(len(marks), np.nan)
    time, track = (columns.get(name, unknown) for name in ("time", "track"))
    _refuse(
        path,
        lines,
        np.isnan(time),
        "time: is missing: with false detections each row needs that of its frame",
    )
    back = np.append(False, np.diff(time) < 0)
    _refuse(
        path,
        lines,
        back,
        "time: is before that of the row above: with false detections each frame needs a time of its own, "
        "and each drive times after those of the drive before",
    )
    right, forward = (
        np.where(np.isnan(columns.get(detected, unknown)), columns[column], columns.get(detected, unknown))
        for column, detected in zip(BOX[:2], _DETECTED_BOX[:2], strict=True)
    )
    _refuse(
        path, lines, false & ~np.isfinite(right + forward), "right, forward: a false detection has no place"
    )
    places = {"right": right[false], "forward": forward[false], "track": track[false], "time": time[false]}
    check_values(path, places, lines[false].tolist())
    return GhostLog(**places, frames=np.unique(time))


def _refuse(path: Path, lines: NDArray[np.intp], wrong: Bools, reason: str) -> None:
    if wrong.any():
        count = f"{int(wrong.sum())} of {len(wrong)} rows have this problem"
        raise UsageError(f"{path}:{lines[int(np.argmax(wrong))]}: {reason}", count)


def write_table(path: Path, table: DetectionTable) -> None:
    """Write a table; ``read_table`` restores its numbers to the last bit.

    Raises:
        UsageError: The file cannot be written.
    """
    names = [*BOX, "detected", *ERRORS, *([] if np.isnan(table.track).all() else _TRACK)]
    arrays = [getattr(table, name) for name in names]
    try:
        with path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(names)
            for row in zip(*(array.tolist() for array in arrays), strict=True):
                writer.writerow([_text(value) for value in row])
    except OSError as error:
        raise UsageError(f"{path}: cannot be written: {error.strerror}") from None


def _text(value: float | bool) -> str:
    return "" if value != value else repr(int(value) if value == int(value) else value)


def _check_header(names: Sequence[str], place: str) -> None:
    repeated = sorted({name for name in names if names.count(name) > 1 and name})
    if repeated:
        raise UsageError(f"{place}: column {repeated[0]!r} occurs twice")
    errors = _DETECTED_BOX[:2] if _DETECTED_BOX[0] in names else ERRORS[:2]
    missing = [name for name in (*_REQUIRED, *errors) if name not in names]
    if missing:
        raise UsageError(
            f"{place}: missing column {', '.join(map(repr, missing))}", _hint(names, missing, errors)
        )


def _hint(names: Sequence[str], missing: Sequence[str], errors: Sequence[str]) -> str:
    if len(names) == 1:  # not separated by commas
        return "not a CSV file? avrare pem convert makes one from a pair of text files"
    unknown = [name for name in names if name and name not in (*BOX, *ERRORS, *_DETECTED_BOX, "detected")]
    near = get_close_matches(missing[0], unknown, n=1)
    if near:
        return f"is it the column {near[0]!r}?"
    return f"it has {', '.join(names)}; needed are {', '.join((*_REQUIRED, *errors))}"


def _errors_of_boxes(columns: dict[str, Floats]) -> dict[str, Floats]:
    errors = {}
    for error, name, detected in zip(ERRORS, BOX[:3], _DETECTED_BOX, strict=True):
        if detected in columns:
            errors[error] = columns[name] - columns[detected]
    if "error_yaw" in errors:
        errors["error_yaw"] = (errors["error_yaw"] + np.pi) % (2 * np.pi) - np.pi
    return errors


def check_values(path: Path, columns: dict[str, Floats], lines: Sequence[int]) -> None:
    """Check that no value is missing or implausible.

    Args:
        path: The file.
        columns: Columns of the file; errors are checked where ``detected`` is 1.
        lines: Line number of each row.

    Raises:
        UsageError: A value is missing or implausible; the message gives file and line.
    """
    detected = columns.get("detected", np.ones(len(lines))) == 1
    for name, (lowest, highest, guess) in _LIMITS.items():
        if name not in columns:
            continue
        values = columns[name]
        checked = detected if name in ERRORS else np.ones(len(values), bool)
        missing = checked & np.isnan(values) & (name not in (*_DEFAULTS, "error_yaw", *_TRACK))
        beyond = checked & ((values < lowest) | (values > highest))
        if name == "detected":
            beyond = (values != 0) & (values != 1)
        for wrong, reason in ((missing, "is missing or not a number"), (beyond, f"is implausible: {guess}")):
            if wrong.any():
                first = int(np.argmax(wrong))
                value = f"{values[first]:g} " if wrong is beyond else ""
                count = f"{int(wrong.sum())} of {len(values)} rows have this problem"
                raise UsageError(f"{path}:{lines[first]}: {name}: {value}{reason}", count)
