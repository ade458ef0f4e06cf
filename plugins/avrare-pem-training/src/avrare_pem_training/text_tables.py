"""Conversion of a pair of text files, one of annotated vehicles and one of their detections, to one table.

Numbers are separated by blanks, and line i of both files is the same vehicle. The first line may name the
columns after a ``#``, in the form ``# Format: <loc_x> <loc_y> <rot> ...``; without it the columns are those
of ``_INPUTS``, or of ``_FLAT_INPUTS`` where there are six. The names of the CSV's columns are known too;
other columns are ignored.

* vehicles: ``loc_x`` (right), ``loc_y`` or ``loc_z`` (forward) [m], ``rot`` [rad], ``dim_l``, ``dim_w``,
  ``dim_h`` [m], ``visibility`` (1 to 4) or ``occlusion`` (0 fully visible, 1 partly, 2 largely occluded, 3
  unknown);

  A rotation named ``rot_y`` (KITTI's), or ``rot`` beside ``loc_z``, is that of a camera's frame, whose y axis
  points down: it is clockwise from right, seen from above, so its sign and that of its error are changed;
* detections: ``detected`` (0 or 1), ``err_loc_x``, ``err_loc_y`` or ``err_loc_z`` [m], and if known
  ``err_rot`` [rad]: truth minus estimate, any number where missed.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from avrare.base.errors import UsageError
from avrare.protocols import Floats
from avrare_pem_training.table import BOX, ERRORS, DetectionTable, check_values, make_table

_INPUTS = ("loc_x", "loc_y", "rot", "dim_l", "dim_w", "dim_h", "visibility")
_COLUMNS = {
    **{name: name for name in (*BOX, "detected", *ERRORS)},
    "loc_x": "right",
    "loc_y": "forward",
    "loc_z": "forward",
    "rot": "yaw",
    "rot_y": "yaw",
    "rot_z": "yaw",
    "dim_l": "length",
    "dim_w": "width",
    "dim_h": "height",
    "vis": "visibility",
    "occlusion": "occlusion",
    "occluded": "occlusion",
    "occ": "occlusion",
    "err_loc_x": "error_right",
    "err_loc_y": "error_forward",
    "err_loc_z": "error_forward",
    "err_rot": "error_yaw",
    "err_rot_y": "error_yaw",
    "err_rot_z": "error_yaw",
}


def convert(inputs: Path, labels: Path) -> DetectionTable:
    """Return the table of both files.

    Raises:
        UsageError: A file cannot be read or their lengths differ; the message gives file and line.
    """
    vehicles, names = _columns(inputs, _INPUTS)
    detections, _ = _columns(labels, ("detected", "err_loc_x", "err_loc_y", "err_rot"))
    if "rot_y" in names or {"rot", "loc_z"} <= set(names):
        vehicles["yaw"] = -vehicles["yaw"]
        if "error_yaw" in detections:
            detections["error_yaw"] = -detections["error_yaw"]
    count, other = len(vehicles["right"]), len(detections["detected"])
    if count != other:
        raise UsageError(f"{inputs} has {count} rows and {labels} has {other}: they are not a pair")
    return make_table(vehicles | detections)


def _visibility(occlusion: Floats, path: Path, lines: Sequence[int]) -> Floats:
    valid = np.isin(occlusion, (0, 1, 2, 3))
    if not valid.all():
        first = int(np.argmin(valid))
        raise UsageError(f"{path}:{lines[first]}: occlusion: {occlusion[first]:g} is not 0, 1, 2 or 3")
    visibility = np.array([4.0, 2.0, 1.0, 2.0])  # of each occlusion
    return visibility[occlusion.astype(np.intp)]


def _columns(path: Path, default: Sequence[str]) -> tuple[dict[str, Floats], Sequence[str]]:
    """Return the columns by the names of the table, and the names in the file."""
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except FileNotFoundError:
        raise UsageError(f"{path}: no such file") from None
    except (OSError, UnicodeDecodeError) as error:
        raise UsageError(f"{path}: not a readable text file: {error}") from None
    rows = [(i, line.split()) for i, line in enumerate(lines, 1) if line.strip() and not line.startswith("#")]
    if not rows:
        raise UsageError(f"{path}: no rows")
    names = _header(lines[0]) or list(default)
    flat_inputs = ("loc_x", "loc_z", "rot", "dim_l", "dim_w", "occlusion")
    if names == list(_INPUTS) and len(rows[0][1]) == len(flat_inputs):
        names = list(flat_inputs)
    for line, row in rows:
        if len(row) != len(names):
            raise UsageError(f"{path}:{line}: {len(row)} numbers, expected {len(names)}: {' '.join(names)}")
    values = np.array([_parse_floats(path, line, row) for line, row in rows])
    columns = {_COLUMNS[name]: values[:, i] for i, name in enumerate(names) if name in _COLUMNS}
    needed = ("loc_x", "loc_y", "rot", "dim_l", "dim_w", "detected", "err_loc_x", "err_loc_y")
    missing = [_COLUMNS[name] for name in needed if name in default and _COLUMNS[name] not in columns]
    if missing:
        raise UsageError(f"{path}: no column gives {', '.join(missing)}", f"known: {', '.join(_COLUMNS)}")
    numbers = [line for line, _ in rows]
    if "occlusion" in columns:
        columns["visibility"] = _visibility(columns.pop("occlusion"), path, numbers)
    check_values(path, columns, numbers)
    return columns, names


def _header(line: str) -> list[str]:
    names = re.findall(r"<([^<>]+)>", line) if line.startswith("#") else []
    return [name.strip().lower() for name in names]


def _parse_floats(path: Path, line: int, row: Sequence[str]) -> list[float]:
    try:
        return [float(cell) for cell in row]
    except ValueError as error:
        raise UsageError(f"{path}:{line}: {error}") from None
