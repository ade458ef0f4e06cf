"""The CSV of annotated vehicles and detections that ``avrare pem fit`` reads.

One line per annotated vehicle and frame, in the order of recording, with a header that names the columns:

* ``right, forward`` [m], ``yaw`` [rad, counter-clockwise from right; straight ahead and aligned: pi/2]: pose
  of the centre of the annotated box in the frame of the ego;
* ``length, width`` [m], and if known ``height`` [m], 1.7 where empty;
* ``visibility``, if known: 1 (below 40 % in view), 2 (40-60), 3 (60-80), 4 (80-100), 4 where empty;
* ``detected``: 0 or 1;
* ``error_right, error_forward`` [m] and if known ``error_yaw`` [rad]: truth minus detection, empty where
  missed; or, instead, the detected box itself: ``detected_right, detected_forward, detected_yaw``.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from difflib import get_close_matches
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from avrare.errors import UsageError
from avrare_gp_pem.features import Box

Floats = NDArray[np.float64]
BOX = ("right", "forward", "yaw", "length", "width", "height", "visibility")
ERRORS = ("error_right", "error_forward", "error_yaw")
_DETECTED_BOX = ("detected_right", "detected_forward", "detected_yaw")
_REQUIRED = ("right", "forward", "yaw", "length", "width", "detected")
_DEFAULTS = {"height": 1.7, "visibility": 4.0}
_MAY_BE_EMPTY = (*_DEFAULTS, "error_yaw")
_LIMITS = {  # (lowest, highest, what a value beyond them may be)
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
}


@dataclass(frozen=True)
class Table:
    """Annotated vehicles and what the detector made of them, each field (n,).

    Attributes:
        right: Centre to the right of the ego [m].
        forward: Centre ahead of the ego [m].
        yaw: Counter-clockwise from right [rad].
        length: [m].
        width: [m].
        height: [m].
        visibility: Category 1 to 4.
        detected: Whether it was.
        error_right: Truth minus detection [m]; NaN where missed.
        error_forward: Likewise.
        error_yaw: Likewise [rad]; all NaN where unknown.
    """

    right: Floats
    forward: Floats
    yaw: Floats
    length: Floats
    width: Floats
    height: Floats
    visibility: Floats
    detected: NDArray[np.bool_]
    error_right: Floats
    error_forward: Floats
    error_yaw: Floats

    def __len__(self) -> int:
        return len(self.right)

    def take(self, index: NDArray[np.bool_] | NDArray[np.intp] | slice) -> Table:
        """A selection of the rows."""
        return Table(**{one.name: getattr(self, one.name)[index] for one in fields(self)})

    @property
    def box(self) -> Box:
        """The annotated boxes."""
        return Box(*(getattr(self, name) for name in BOX))


def errors_in(frame: str, rows: Table) -> Floats:
    """(n, 2) errors along and across the vehicle ("vehicle"), or to the right and forward ("ego") [m]."""
    if frame == "ego":
        return np.stack([rows.error_right, rows.error_forward], axis=-1)
    cos, sin = np.cos(rows.yaw), np.sin(rows.yaw)
    along = cos * rows.error_right + sin * rows.error_forward
    return np.stack([along, cos * rows.error_forward - sin * rows.error_right], axis=-1)


def table(columns: dict[str, Floats]) -> Table:
    """The table of these columns; undetected rows lose their errors, missing numbers get their defaults."""
    count = len(columns["right"])
    detected = columns["detected"] == 1
    full = {name: np.full(count, value) for name, value in _DEFAULTS.items()} | columns
    for name, value in _DEFAULTS.items():
        full[name] = np.where(np.isnan(full[name]), value, full[name])
    for name in ERRORS:
        values = full.get(name, np.full(count, np.nan))
        full[name] = np.where(detected, values, np.nan)
    return Table(detected=detected, **{name: full[name] for name in (*BOX, *ERRORS)})


def read(path: Path) -> Table:
    """Read a CSV file (see the module).

    Raises:
        UsageError: The file cannot be read, lacks a column, or holds a value that cannot be right; the
            message has file and line.
    """
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            rows = list(_rows(file))
    except FileNotFoundError:
        raise UsageError(
            f"{path}: no such file", "avrare pem convert writes one from two text files"
        ) from None
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise UsageError(f"{path}: not a readable CSV file: {error}") from None
    if not rows:
        raise UsageError(f"{path}: the file is empty", f"first line: {','.join((*BOX, 'detected', *ERRORS))}")
    (line, header), body = rows[0], rows[1:]
    names = [name.strip().lower() for name in header]
    _check_header(names, f"{path}:{line}")
    if not body:
        raise UsageError(f"{path}: a header and no rows")
    lines = [number for number, _ in body]
    columns = _numbers(path, names, body)
    columns |= _errors_of_boxes(columns)
    check_values(path, columns, lines)
    return table(columns)


def write(path: Path, content: Table) -> None:
    """Write a table in the form that ``read`` reads; numbers survive the round trip to the last bit.

    Raises:
        UsageError: The file cannot be written.
    """
    arrays = [getattr(content, name) for name in (*BOX, "detected", *ERRORS)]
    try:
        with path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow([*BOX, "detected", *ERRORS])
            for row in zip(*(array.tolist() for array in arrays), strict=True):
                writer.writerow([_text(value) for value in row])
    except OSError as error:
        raise UsageError(f"{path}: cannot be written: {error.strerror}") from None


def _text(value: float | bool) -> str:
    return "" if value != value else repr(int(value) if value == int(value) else value)


def _rows(file: Iterator[str]) -> Iterator[tuple[int, list[str]]]:
    """Line number and cells of every line that is not blank."""
    reader = csv.reader(file)
    for row in reader:
        if any(cell.strip() for cell in row):
            yield reader.line_num, row


def _check_header(names: Sequence[str], place: str) -> None:
    twice = sorted({name for name in names if names.count(name) > 1 and name})
    if twice:
        raise UsageError(f"{place}: column {twice[0]!r} occurs twice")
    errors = _DETECTED_BOX[:2] if _DETECTED_BOX[0] in names else ERRORS[:2]
    missing = [name for name in (*_REQUIRED, *errors) if name not in names]
    if missing:
        raise UsageError(
            f"{place}: missing column {', '.join(map(repr, missing))}", _hint(names, missing, errors)
        )


def _hint(names: Sequence[str], missing: Sequence[str], errors: Sequence[str]) -> str:
    if len(names) == 1:  # not separated by commas
        return "not a CSV file? avrare pem convert makes one from a pair of text files"
    spare = [name for name in names if name and name not in (*BOX, *ERRORS, *_DETECTED_BOX, "detected")]
    near = get_close_matches(missing[0], spare, n=1)
    if near:
        return f"is it the column {near[0]!r}?"
    return f"it has {', '.join(names)}; needed are {', '.join((*_REQUIRED, *errors))}"


def _numbers(path: Path, names: Sequence[str], body: Sequence[tuple[int, list[str]]]) -> dict[str, Floats]:
    """The known columns as numbers; an empty cell is NaN."""
    for line, row in body:
        if len(row) != len(names):
            raise UsageError(f"{path}:{line}: {len(row)} values in a table of {len(names)} columns")
    known = {*BOX, *ERRORS, *_DETECTED_BOX, "detected"}
    return {name: _number(path, name, i, body) for i, name in enumerate(names) if name in known}


def _number(path: Path, name: str, column: int, body: Sequence[tuple[int, list[str]]]) -> Floats:
    values = np.empty(len(body))
    for i, (line, row) in enumerate(body):
        cell = row[column].strip()
        try:
            values[i] = float(cell) if cell else np.nan
        except ValueError:
            raise UsageError(f"{path}:{line}: {name}: {cell!r} is not a number") from None
    return values


def _errors_of_boxes(columns: dict[str, Floats]) -> dict[str, Floats]:
    """Errors from the detected boxes, where these are given."""
    errors = {}
    for name, given in zip(ERRORS, _DETECTED_BOX, strict=True):
        if given in columns:
            errors[name] = columns[name.removeprefix("error_")] - columns[given]
    if "error_yaw" in errors:
        errors["error_yaw"] = (errors["error_yaw"] + np.pi) % (2 * np.pi) - np.pi
    return errors


def check_values(path: Path, columns: dict[str, Floats], lines: Sequence[int]) -> None:
    """Raise ``UsageError`` with file and line where a value cannot be right.

    Args:
        path: The file.
        columns: Those of a table that it has; errors are looked at where ``detected`` is 1.
        lines: Where in the file each row is.
    """
    detected = columns.get("detected", np.ones(len(lines))) == 1
    for name, (lowest, highest, guess) in _LIMITS.items():
        if name not in columns:
            continue
        values, of_detection = columns[name], name in ERRORS
        where = detected if of_detection else np.ones(len(values), bool)
        broken = where & np.isnan(values) & (name not in _MAY_BE_EMPTY)
        beyond = where & ((values < lowest) | (values > highest))
        if name == "detected":
            beyond = (values != 0) & (values != 1)
        for wrong, words in ((broken, "is missing or not a number"), (beyond, f"cannot be: {guess}")):
            if wrong.any():
                first = int(np.argmax(wrong))
                value = "" if words.startswith("is") else f"{values[first]:g} "
                count = f"{int(wrong.sum())} of {len(values)} rows are like this"
                raise UsageError(f"{path}:{lines[first]}: {name}: {value}{words}", count)
