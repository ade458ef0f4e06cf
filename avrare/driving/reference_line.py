"""Reference lines of roads, and coordinates along them: station s and lateral offset d, left is positive.

Two kinds: ``CurvedLine``, of straights, arcs and clothoids, whose projection is exact where its curvature is
constant and otherwise iterated to rounding; and ``PolygonalLine`` through points, whose tangents turn from
point to point along each segment (Bender, Ziegler and Stiller, "Lanelets", IV 2014), so that its projection
is continuous and the root of one quadratic. Both go on straight beyond their ends. All functions are
elementwise over arrays.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from avrare.base.errors import UsageError

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(8)
_ITERATIONS = 50
_CLOSE = 1e-10  # last step of a projection, relative to the size of its station
_SHORT = 1e-6  # points of a polyline nearer than this are one [m]
_GROUP = 32  # points of a polyline that are searched together
_BLOCK = 1_000_000  # distances at a time in the search for the nearest sample


class ReferenceLine(ABC):
    """Directed curve in the plane with stations 0 to ``length``, straight before and beyond."""

    @property
    @abstractmethod
    def length(self) -> float:
        """Length between the ends [m]."""

    @abstractmethod
    def frame(self, s: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        """Return x, y [m], heading [rad], which does not jump, and curvature [1/m] at stations."""

    @abstractmethod
    def to_road(self, x: Floats, y: Floats) -> tuple[Floats, Floats]:
        """Return station and offset of points, with the nearest foot; NaN beyond the centre of curvature."""

    def to_plane(self, s: Floats, d: Floats) -> tuple[Floats, Floats]:
        """Return x and y of the points at station ``s`` and offset ``d``."""
        x, y, heading, _ = self.frame(np.asarray(s, dtype=np.float64))
        return x - d * np.sin(heading), y + d * np.cos(heading)

    def advance(self, s: Floats, d: Floats, distance: Floats) -> Floats:
        """Return the station that is ``distance`` further along the curve at the constant offset ``d``.

        That curve has the length s - d h(s) with the line's heading h: one equation, solved by Newton.
        """
        start = self.frame(np.asarray(s, dtype=np.float64))[2]
        reached = np.asarray(s + distance)
        moving = np.ones(np.broadcast_shapes(reached.shape, np.shape(d)), dtype=np.bool_)
        for _ in range(_ITERATIONS):
            _, _, heading, curvature = self.frame(reached)
            step = (reached - s - d * (heading - start) - distance) / (1.0 - curvature * d)
            reached = np.where(moving, reached - step, reached)  # a number does not wait for its neighbours
            moving &= np.abs(step) > _CLOSE * (1.0 + np.abs(reached))
            if not moving.any():
                break
        return reached

    def heading(self, s: Floats) -> Floats:
        """Return the direction of the line [rad]."""
        return self.frame(np.asarray(s, dtype=np.float64))[2]

    def curvature(self, s: Floats) -> Floats:
        """Return the curvature, positive to the left [1/m]."""
        return self.frame(np.asarray(s, dtype=np.float64))[3]


@dataclass(frozen=True)
class Piece:
    """Piece of a line: a straight, an arc, or a clothoid, whose curvature changes linearly.

    Attributes:
        length: [m].
        curvature: At its begin, positive to the left [1/m].
        end_curvature: At its end [1/m].
    """

    length: float
    curvature: float = 0.0
    end_curvature: float = 0.0

    def __post_init__(self) -> None:
        if not 0.0 < self.length < np.inf:
            raise UsageError(f"a piece of a road is {self.length:g} m long", "give a finite length above 0")
        if not np.isfinite([self.curvature, self.end_curvature]).all():
            text = f"a piece of a road has the curvatures {self.curvature:g} and {self.end_curvature:g} 1/m"
            raise UsageError(text, "give finite ones; 0 is straight")


@dataclass(frozen=True)
class CurvedLine(ReferenceLine):
    """Line of pieces, each with the direction in which the one before it ends.

    Attributes:
        pieces: From station 0 on.
        x: Of station 0 [m].
        y: Of station 0 [m].
        start_heading: Direction at station 0 [rad].
    """

    pieces: tuple[Piece, ...]
    x: float = 0.0
    y: float = 0.0
    start_heading: float = 0.0

    @cached_property
    def length(self) -> float:
        """Sum of the lengths of the pieces [m]."""
        return float(sum(piece.length for piece in self.pieces))

    @cached_property
    def _table(self) -> Floats:
        # (6, K + 2): station, x, y, heading, curvature and its slope where each piece begins; the first
        # and the last one are the straights before and beyond, and the first counts back from station 0
        rows = [[0.0, self.x, self.y, self.start_heading, 0.0, 0.0]]
        at = np.array(rows[0])
        for piece in self.pieces:
            slope = (piece.end_curvature - piece.curvature) / piece.length
            turn = max(abs(piece.curvature), abs(piece.end_curvature)) * piece.length
            # a piece that turns by 0.5 rad: the quadrature then errs by less than rounding
            parts = max(1, math.ceil(turn / 0.5)) if slope else 1
            step = piece.length / parts
            for part in range(parts):
                at[4:] = piece.curvature + slope * part * step, slope
                rows.append(at.tolist())
                at[:4] = at[0] + step, *(value.item() for value in _advance(at[:, None], np.array([step])))
        at[4:] = 0.0
        return np.array([*rows, at.tolist()]).T

    def frame(self, s: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        """Return x, y, heading and curvature at stations."""
        table = self._table
        piece = np.searchsorted(table[0, 1:], s, side="right")
        origin = table[:, piece]
        u = s - origin[0]
        x, y, heading = _advance(origin, u)
        return x, y, heading, origin[4] + origin[5] * u

    @cached_property
    def _samples(self) -> tuple[Floats, Floats, Floats]:
        sharpest = max(
            (abs(k) for piece in self.pieces for k in (piece.curvature, piece.end_curvature)), default=0.0
        )
        spacing = min(20.0, 0.5 / sharpest) if sharpest else 20.0
        s = np.linspace(0.0, self.length, max(2, math.ceil(self.length / spacing) + 1))
        x, y, _, _ = self.frame(s)
        return s, x, y

    def to_road(self, x: Floats, y: Floats) -> tuple[Floats, Floats]:
        """Return station and offset; each step projects onto the circle of curvature at the last foot."""
        x, y = np.broadcast_arrays(np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64))
        px, py = x.ravel(), y.ravel()
        stations, sample_x, sample_y = self._samples
        s, d = stations[_nearest(px, py, sample_x, sample_y)], np.full(px.shape, np.nan)
        rows = np.flatnonzero(np.isfinite(px) & np.isfinite(py))
        for _ in range(_ITERATIONS):
            if not len(rows):
                break
            foot_x, foot_y, heading, curvature = self.frame(s[rows])
            along, across = _turn(px[rows] - foot_x, py[rows] - foot_y, heading)
            step = _project_on_circle(along, across, curvature)
            s[rows] += step
            ended = np.abs(step) <= _CLOSE * (1.0 + np.abs(s[rows]))
            valid = ended & (curvature * across < 1.0)
            d[rows[valid]] = across[valid]
            rows = rows[~ended]
        s[np.isnan(d)] = np.nan
        return s.reshape(x.shape), d.reshape(x.shape)


@dataclass(frozen=True, eq=False)
class PolygonalLine(ReferenceLine):
    """Line through points.

    Attributes:
        points: (K, 2) x and y [m], at least two.
    """

    points: Floats

    def __post_init__(self) -> None:
        points = _drop_turns(np.asarray(self.points, dtype=np.float64))
        if len(points) < 2 or not np.isfinite(points).all():
            raise UsageError(
                "a line needs two points that differ", "look for points that are repeated or NaN"
            )
        object.__setattr__(self, "points", points)

    @cached_property
    def length(self) -> float:
        """Sum of the lengths of the segments [m]."""
        return float(self._stations[-1])

    @cached_property
    def _steps(self) -> Floats:
        return np.asarray(np.hypot(*np.diff(self.points, axis=0).T))

    @cached_property
    def _stations(self) -> Floats:
        return np.concatenate([[0.0], np.cumsum(self._steps)])

    @cached_property
    def _segments(self) -> Floats:
        # (11, K + 1): station, length, x, y, direction, tangent at the begin and at the end of each segment,
        # and the heading at its begin, without jumps; the straights before and beyond count from inside
        directions = np.diff(self.points, axis=0) / self._steps[:, None]
        directions = np.concatenate([directions[:1], directions, directions[-1:]])
        tangents = directions[:-1] + directions[1:]
        tangents /= np.hypot(*tangents.T)[:, None]
        begin = np.concatenate([tangents[:1], tangents])
        end = np.concatenate([tangents, tangents[-1:]])
        origin = np.concatenate([self.points[:1], self.points])
        stations = np.concatenate([[0.0], self._stations])
        lengths = np.concatenate([[1.0], self._steps, [1.0]])
        headings = np.unwrap(np.arctan2(begin[:, 1], begin[:, 0]))
        return np.array([stations, lengths, *origin.T, *directions.T, *begin.T, *end.T, headings])

    @cached_property
    def _groups(self) -> tuple[Floats, Floats, Floats]:
        # Points that follow one another in groups, (2, G, K) with NaN at the end, and the circle of each.
        count = -(-len(self.points) // _GROUP)
        table = np.full((count * _GROUP, 2), np.nan)
        table[: len(self.points)] = self.points
        groups = table.reshape(count, _GROUP, 2)
        centres = np.nanmean(groups, axis=1)
        reach = np.nanmax(np.hypot(*(groups - centres[:, None]).transpose(2, 0, 1)), axis=1)
        return groups.transpose(2, 0, 1), centres.T, reach

    def _nearest_points(self, x: Floats, y: Floats) -> Integers:
        # Only groups whose circle is near enough are looked at.
        if len(x) * len(self.points) < 100_000:  # few enough to compute all
            return _nearest(x, y, *self.points.T)
        nearest, finite = np.zeros(len(x), dtype=np.int64), np.flatnonzero(np.isfinite(x) & np.isfinite(y))
        (points_x, points_y), (middle_x, middle_y), reach = self._groups
        for block in np.array_split(finite, 1 + len(finite) * len(reach) // _BLOCK):
            if not len(block):
                continue
            separation = np.hypot(x[block, None] - middle_x, y[block, None] - middle_y)
            most = (separation + reach).min(axis=1) * (1.0 + _CLOSE) + _CLOSE
            rows, groups = np.nonzero(separation - reach <= most[:, None])
            at_x, at_y = x[block[rows]], y[block[rows]]
            distance = (at_x[:, None] - points_x[groups]) ** 2 + (at_y[:, None] - points_y[groups]) ** 2
            inside = np.nanargmin(distance, axis=1)
            least = distance[np.arange(len(rows)), inside]
            order = np.lexsort((groups, least, rows))  # the first of points that are equally near
            first = order[np.searchsorted(rows[order], np.arange(len(block)))]
            nearest[block] = groups[first] * _GROUP + inside[first]
        return nearest

    def frame(self, s: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        """Return x, y, heading and curvature at stations."""
        segment = np.searchsorted(self._stations, s, side="right")
        station, length, x, y, cos, sin, bx, by, ex, ey, heading = self._segments[:, segment]
        u = s - station
        share = u / length
        tx, ty = bx + share * (ex - bx), by + share * (ey - by)
        curvature = (tx * (ey - by) - ty * (ex - bx)) / (length * (tx * tx + ty * ty))
        turned = np.arctan2(bx * ty - by * tx, bx * tx + by * ty)
        return x + u * cos, y + u * sin, heading + turned, curvature

    def to_road(self, x: Floats, y: Floats) -> tuple[Floats, Floats]:
        """Return station and offset; the segment is searched from the nearest point on."""
        x, y = np.broadcast_arrays(np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64))
        px, py = x.ravel(), y.ravel()
        s, d = np.full(px.shape, np.nan), np.full(px.shape, np.nan)
        segment = self._nearest_points(px, py) + 1
        rows, last = np.flatnonzero(np.isfinite(px) & np.isfinite(py)), len(self.points)
        for _ in range(_ITERATIONS):
            if not len(rows):
                break
            here = segment[rows]
            values = self._segments[:, here]
            share, across = _project_on_segment(px[rows], py[rows], values)
            low = np.where(here == 0, -np.inf, -_CLOSE)  # a point on a border belongs to either side
            high = np.where(here == last, np.inf, np.where(here == 0, _CLOSE, 1.0 + _CLOSE))
            inside = (share >= low) & (share <= high)
            s[rows[inside]] = (values[0] + share * values[1])[inside]
            d[rows[inside]] = across[inside]
            ended = inside | np.isnan(share)
            segment[rows] = np.clip(here + np.where(share < low, -1, 1), 0, last)
            rows = rows[~ended]
        return s.reshape(x.shape), d.reshape(x.shape)


def _drop_turns(points: Floats) -> Floats:
    # Without points that are repeated, or at which a line turns back on itself: it has no direction there.
    while len(points):
        points = points[np.concatenate([[True], np.hypot(*np.diff(points, axis=0).T) > _SHORT])]
        steps = np.diff(points, axis=0) / np.hypot(*np.diff(points, axis=0).T)[:, None]
        # a line that turns back, by 151 degrees and more
        back = np.flatnonzero(np.hypot(*(steps[1:] + steps[:-1]).T) < 0.5)
        if not len(back):
            break
        points = np.delete(points, back[0] + 1, axis=0)
    return points


def _advance(origin: Floats, u: Floats) -> tuple[Floats, Floats, Floats]:
    # x, y and heading at ``u`` from where pieces begin (rows of ``CurvedLine._table``)
    _, x, y, heading, curvature, slope = origin
    half = 0.5 * curvature * u
    chord = u * np.sinc(half / np.pi)
    dx, dy = chord * np.cos(heading + half), chord * np.sin(heading + half)
    bent = slope != 0.0
    if bent.any():  # by quadrature, node after node: a matrix product's bits depend on the number of rows
        reach, first, turn, rate = (part[bent] for part in (u, heading, curvature, slope))
        along, across = np.zeros_like(reach), np.zeros_like(reach)
        for node, weight in zip(_NODES, _WEIGHTS, strict=True):
            at = 0.5 * reach * (node + 1.0)
            angle = first + (turn + 0.5 * rate * at) * at
            along += weight * np.cos(angle)
            across += weight * np.sin(angle)
        dx[bent], dy[bent] = 0.5 * reach * along, 0.5 * reach * across
    return x + dx, y + dy, heading + (curvature + 0.5 * slope * u) * u


def _turn(x: Floats, y: Floats, heading: Floats) -> tuple[Floats, Floats]:
    cos, sin = np.cos(heading), np.sin(heading)
    return cos * x + sin * y, cos * y - sin * x


def _project_on_circle(along: Floats, across: Floats, curvature: Floats) -> Floats:
    # Arc from the foot so far to the foot on the circle of curvature: exact on straights and arcs.
    curved = np.abs(curvature) > 1e-12
    safe = np.where(curved, curvature, 1.0)
    return np.where(curved, np.arctan2(safe * along, 1.0 - safe * across) / safe, along)


def _project_on_segment(x: Floats, y: Floats, segment: Floats) -> tuple[Floats, Floats]:
    # Share t of the segment and offset: (q - p(t)) . tangent(t) = 0 is quadratic in t; NaN without a foot.
    _, length, x0, y0, cos, sin, bx, by, ex, ey, _ = segment
    rx, ry, dx, dy = x - x0, y - y0, ex - bx, ey - by
    forth_x, forth_y = length * cos, length * sin
    a = forth_x * dx + forth_y * dy
    b = forth_x * bx + forth_y * by - (rx * dx + ry * dy)
    c = rx * bx + ry * by
    with np.errstate(invalid="ignore", divide="ignore"):
        share = 2.0 * c / (b + np.sqrt(b * b + 4.0 * a * c))
        share = np.where(b > 0.0, share, np.nan)
    tx, ty = bx + share * dx, by + share * dy
    size = np.hypot(tx, ty)
    share = np.where(size > _SHORT, share, np.nan)  # no direction where a line turns back at once
    px, py = rx - share * forth_x, ry - share * forth_y
    return share, (tx * py - ty * px) / np.maximum(size, _SHORT)


def _nearest(x: Floats, y: Floats, sample_x: Floats, sample_y: Floats) -> Integers:
    nearest = np.zeros(len(x), dtype=np.int64)
    rows = max(1, _BLOCK // len(sample_x))
    for begin in range(0, len(x), rows):
        block = slice(begin, begin + rows)
        with np.errstate(invalid="ignore", over="ignore"):
            distance = (x[block, None] - sample_x) ** 2 + (y[block, None] - sample_y) ** 2
        nearest[block] = distance.argmin(axis=1)
    return nearest
