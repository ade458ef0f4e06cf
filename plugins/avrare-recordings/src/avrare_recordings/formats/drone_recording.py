"""Recordings from the air in the CSV format of highD, or of its successors inD, rounD, exiD and uniD.

A recording is three files: ``NN_tracks.csv``, ``NN_tracksMeta.csv``, ``NN_recordingMeta.csv``. In highD the
corners of boxes are in the picture's coordinates, y downwards, and the lane markings of both carriageways are
given: every vehicle is seen in the frame of its own carriageway. The successors give centres and headings in
the plane, and no lanes: their road is the caller's, or a network in the same coordinates.
"""

from __future__ import annotations

import csv
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, TextIO

import numpy as np
from numpy.typing import NDArray

from avrare.base.errors import UsageError
from avrare.driving import Lane, Road
from avrare.driving.lanes import ENDLESS
from avrare.protocols import Floats
from avrare.results.recordings import FIELDS, Recording, VehicleTrack, assemble_recording
from avrare_recordings.roads.plane_drives import Obstacle, PlaneDrives

if TYPE_CHECKING:
    from commonroad.scenario.lanelet import LaneletNetwork

_END = "_tracks.csv"
_MOTION = ("xVelocity", "yVelocity", "xAcceleration", "yAcceleration")
_HIGHD = ("frame", "id", "x", "y", "width", "height", *_MOTION)
_PLANE = ("frame", "trackId", "xCenter", "yCenter", "heading", "width", "length", *_MOTION)


def is_drone_recording(path: Path) -> bool:
    """Return whether a file holds the tracks of a drone recording."""
    return path.name.endswith(_END) and path.with_name(path.name.replace(_END, "_tracksMeta.csv")).exists()


def open_drone_recording(
    path: str, road: Road | None = None, network: tuple[LaneletNetwork, float] | None = None
) -> CarriagewayDrives | PlaneDrives:
    """Read a recording by its file of tracks.

    Args:
        path: The file ``NN_tracks.csv``.
        road: Road of a recording that has no lanes itself, if any.
        network: Of a recording that has no lanes itself, and the step of its light cycles [s].

    Raises:
        UsageError: A file or a column is missing, or a number cannot be read or is not finite.
    """
    tracks = Path(path)
    meta = [
        tracks.with_name(tracks.name.replace(_END, f"_{kind}.csv"))
        for kind in ("tracksMeta", "recordingMeta")
    ]
    about, recording = map(_read_table, meta)
    columns = _read_header(tracks)
    required = _HIGHD if "xCenter" not in columns else _PLANE
    if missing := [name for name in required if name not in columns]:
        hint = "expected the columns of highD or of inD"
        raise UsageError(f"{tracks}: there is no column {missing[0]!r}", hint)
    try:
        table = _read_columns(tracks, columns, required)
        rate = float(recording[0]["frameRate"])
    except (ValueError, KeyError, IndexError) as error:
        raise UsageError(f"{tracks}: not a recording in the format of highD or inD: {error}") from None
    if not 0.0 < rate < np.inf:
        raise UsageError(f"{meta[1]}: the frameRate is {rate:g}", "it must be a number above 0 [1/s]")
    if required is _HIGHD:
        return _read_highd(path, table, about, recording[0], 1.0 / rate)
    obstacles = _read_plane(table)
    names, (lanes, step) = tuple(obstacles), network or (None, None)
    lanelets = () if lanes is None else tuple(lanes.lanelets)
    return PlaneDrives(path, 1.0 / rate, obstacles, names, lanelets, road, lanes, step)


@dataclass(frozen=True)
class _Track:
    length: float
    width: float
    frames: NDArray[np.int64]
    states: Floats  # (5, K)


@dataclass(frozen=True)
class CarriagewayDrives:
    """Recording of two carriageways, on which any vehicle can be the ego among those that go its way.

    Attributes:
        path: File of tracks.
        dt: Step [s].
        tracks: Vehicles by name.
        carriageways: Name -> carriageway and its road.
    """

    path: str
    dt: float
    tracks: Mapping[str, _Track]
    carriageways: Mapping[str, tuple[int, Road]]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the vehicles."""
        return tuple(self.tracks)

    @cached_property
    def _spans(self) -> dict[str, tuple[int, int]]:
        return {name: (int(track.frames[0]), int(track.frames[-1])) for name, track in self.tracks.items()}

    def recording(self, ego: str) -> Recording:
        """Return the drive of one ego among those of its carriageway; UsageError if it is not there."""
        if ego not in self.tracks:
            raise UsageError(f"{self.path}: unknown vehicle {ego!r}", "choose an ego by its id")
        ego_track = self.tracks[ego]
        first, last = self._spans[ego]
        samples = last - first + 1
        if len(ego_track.frames) != samples:
            raise UsageError(
                f"{self.path}: vehicle {ego} has gaps in time", "the ego needs a row at every frame"
            )
        side, road = self.carriageways[ego]
        present = [
            name
            for name, (begin, end) in self._spans.items()
            if begin <= last and end >= first and self.carriageways[name][0] == side
        ]
        tracks = {name: _place(name, self.tracks[name], first, samples) for name in present}
        others = [track for name, track in tracks.items() if name != ego]
        return assemble_recording(self.path, self.dt, self.dt * first, tracks[ego], others, road)


def _place(name: str, track: _Track, first: int, samples: int) -> VehicleTrack:
    present, states = np.zeros(samples, dtype=bool), np.full((len(FIELDS), samples), np.nan)
    at = track.frames - first
    inside = (at >= 0) & (at < samples)
    present[at[inside]] = True
    states[:, at[inside]] = track.states[:, inside]
    return VehicleTrack(name, track.length, track.width, present, states)


def _read_highd(
    path: str,
    table: Mapping[str, Floats],
    about: list[dict[str, str]],
    recording: dict[str, str],
    dt: float,
) -> CarriagewayDrives:
    roads = {
        1: _carriageway(path, recording.get("upperLaneMarkings", ""), 1.0),
        2: _carriageway(path, recording.get("lowerLaneMarkings", ""), -1.0),
    }
    try:
        direction = {int(row["id"]): int(row["drivingDirection"]) for row in about}
    except (KeyError, ValueError) as error:
        raise UsageError(f"{path}: the tracksMeta file lacks id or drivingDirection: {error}") from None
    tracks, carriageways = {}, {}
    for number, rows in _by_vehicle(table["id"], table["frame"]).items():
        side = direction.get(number)
        if side not in roads:
            raise UsageError(
                f"{path}: vehicle {number} has no drivingDirection", "look into the tracksMeta file"
            )
        x, y, long, wide, vx, vy, ax, ay = (table[name][rows] for name in _HIGHD[2:])
        # the upper carriageway drives to the left of the picture: half a turn, so that y is the picture's
        turn = 1.0 if side == 2 else -1.0
        place = turn * (x + 0.5 * long), -turn * (y + 0.5 * wide)
        states = _states(*place, turn * vx, -turn * vy, turn * ax, -turn * ay)
        frames = table["frame"][rows].astype(np.int64)
        tracks[str(number)] = _Track(float(np.median(long)), float(np.median(wide)), frames, states)
        carriageways[str(number)] = side, roads[side]
    return CarriagewayDrives(path, dt, tracks, carriageways)


def _carriageway(path: str, markings: str, turn: float) -> Road:
    try:
        borders = np.sort(turn * np.array([float(word) for word in markings.split(";") if word.strip()]))
    except ValueError:
        borders = np.array([np.nan])
    if not np.isfinite(borders).all():
        raise UsageError(f"{path}: the lane markings {markings!r} are not numbers")
    if len(borders) < 2:
        raise UsageError(f"{path}: there are no lane markings in the recordingMeta file")
    ends = np.array([-ENDLESS, ENDLESS])
    lanes = tuple(Lane(ends, np.full(2, right), np.full(2, left)) for right, left in pairwise(borders))
    centres = tuple(float(centre) for centre in 0.5 * (borders[:-1] + borders[1:]))
    return Road(centres, float(np.median(np.diff(borders))), (), 0.0, 420.0, lanes=lanes)


def _read_plane(table: Mapping[str, Floats]) -> dict[str, Obstacle]:
    obstacles = {}
    for number, rows in _by_vehicle(table["trackId"], table["frame"]).items():
        x, y, heading, width, length, vx, vy = (table[name][rows] for name in _PLANE[2:9])
        heading = np.remainder(np.deg2rad(heading) + np.pi, 2.0 * np.pi) - np.pi
        states = np.stack([x, y, heading, np.cos(heading) * vx + np.sin(heading) * vy])
        frames = table["frame"][rows].astype(np.int64)
        name = str(number)
        obstacles[name] = Obstacle(name, float(np.median(length)), float(np.median(width)), frames, states)
    return obstacles


def _states(x: Floats, y: Floats, vx: Floats, vy: Floats, ax: Floats, ay: Floats) -> Floats:
    # highD has no headings: that of the motion; speed and acceleration along it
    heading = np.arctan2(vy, vx)
    cos, sin = np.cos(heading), np.sin(heading)
    return np.stack([x, y, heading, cos * vx + sin * vy, cos * ax + sin * ay])


def _by_vehicle(numbers: Floats, frames: Floats) -> dict[int, NDArray[np.intp]]:
    order = np.lexsort((frames, numbers))
    names, begins = np.unique(numbers[order], return_index=True)
    return {int(name): rows for name, rows in zip(names, np.split(order, begins[1:]), strict=True)}


def _read_header(path: Path) -> list[str]:
    with _open(path) as lines:
        return next(csv.reader(lines), [])


def _read_columns(path: Path, columns: list[str], wanted: tuple[str, ...]) -> dict[str, Floats]:
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "loadtxt: input contained no data")
        use = [columns.index(name) for name in wanted]
        values = np.loadtxt(path, delimiter=",", skiprows=1, usecols=use, ndmin=2)
    if not values.size:
        raise UsageError(f"{path}: there are no rows below the header")
    if not (finite := np.isfinite(values)).all():
        row, column = np.argwhere(~finite)[0]
        raise UsageError(f"{path}: row {row + 1} has no number for {wanted[column]}: {values[row, column]:g}")
    return dict(zip(wanted, values.T, strict=True))


def _read_table(path: Path) -> list[dict[str, str]]:
    with _open(path) as lines:
        return list(csv.DictReader(lines, restval=""))


@contextmanager
def _open(path: Path) -> Iterator[TextIO]:
    try:
        with path.open(encoding="utf-8", newline="") as lines:
            yield lines
    except OSError as error:
        hint = "a recording has the files tracks, tracksMeta and recordingMeta"
        raise UsageError(f"{path}: {error.strerror}", hint) from None
    except (UnicodeDecodeError, csv.Error) as error:
        raise UsageError(f"{path}: not CSV in UTF-8: {error}") from None
