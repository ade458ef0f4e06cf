"""A rollout as a CSV file that ``avrare monitor`` reads."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from itertools import count

import numpy as np

from avrare.driving import Scene
from avrare.failures.failure import table
from avrare.record.trace import FIELDS, Recording

_EGO = "ego"


def to_csv(recording: Recording) -> str:
    """Text of the file: vehicles where there is a road, else named signals; every number to the last bit.

    Vehicles have a row each for each sample; the ego is called ``ego``, the others as ``vehicle_names`` says.
    """
    if recording.scene is None:
        columns, values = table(recording.signals)
        lines = [["time", *(name.replace("[", "_").replace("]", "").replace(",", "_") for name in columns)]]
        lines += [[_number(recording.time(t)), *map(_number, values[t])] for t in range(recording.samples)]
        return _text(lines)
    lines = [["time", "vehicle", *FIELDS[:4], "length", "width", FIELDS[4]]]
    for t in range(recording.samples):
        for name, states, size in _vehicles(recording, recording.scene, t):
            numbers = map(_number, [*states[:4], *size, states[4]])
            lines.append([_number(recording.time(t)), name, *numbers])
    return _text(lines)


def vehicle_names(names: Sequence[str]) -> tuple[str, ...]:
    """What the other vehicles are called in the file: as in the scene, unless one is called as the ego."""
    free = (f"{_EGO}_{number}" for number in count(2))
    return tuple(next(one for one in free if one not in names) if name == _EGO else name for name in names)


def _vehicles(
    recording: Recording, scene: Scene, t: int
) -> list[tuple[str, Sequence[float], tuple[float, float]]]:
    """Name, state (in the order of ``FIELDS``) and length and width of every vehicle at a sample."""
    own = [float(recording.signals[f"ego_{field}"][t]) for field in FIELDS]
    states = np.stack([recording.signals[f"others_{field}"][t] for field in FIELDS], axis=-1)
    sizes = list(zip(scene.lengths.tolist(), scene.widths.tolist(), strict=True))
    return [
        (_EGO, own, (scene.ego_length, scene.ego_width)),
        *zip(vehicle_names(scene.names), states.tolist(), sizes, strict=True),
    ]


def _number(value: float) -> str:
    return repr(float(value))


def _text(lines: Sequence[Sequence[str]]) -> str:
    content = io.StringIO()
    csv.writer(content, lineterminator="\n").writerows(lines)  # a vehicle's name may have commas
    return content.getvalue()
