"""Points of curves: clothoids and rational splines of trajectories, polynomials of roads."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from avrare.driving.reference_line import CurvedLine, Piece
from avrare.protocols import Floats

_POINTS = 400
"""Points of a spline."""


def sample_clothoids(pieces: Sequence[tuple[float, float, float]]) -> tuple[tuple[float, float, float], ...]:
    """Return x, y and heading of points of pieces (length, curvature at the begin and at the end)."""
    line = CurvedLine(tuple(Piece(*piece) for piece in pieces))
    step = 0.25  # distance of points [m]
    stations = np.linspace(0.0, line.length, max(2, 1 + round(line.length / step)))
    x, y, heading, _ = line.frame(stations)
    return tuple(zip(x.tolist(), y.tolist(), heading.tolist(), strict=True))


def sample_nurbs(
    order: int, weights: Sequence[float], knots: Sequence[float]
) -> tuple[tuple[float, ...], ...]:
    """Return (M, P) shares of the P control points in each of M points of a rational spline."""
    ends = knots[order - 1], knots[len(weights)]
    u = np.linspace(*ends, _POINTS)
    u[-1] = np.nextafter(ends[1], ends[0])
    table = np.array(knots)
    basis = ((table[:-1] <= u[:, None]) & (u[:, None] < table[1:])).astype(np.float64)
    for degree in range(1, order):
        left, right = table[degree:-1] - table[: -degree - 1], table[degree + 1 :] - table[1:-degree]
        with np.errstate(divide="ignore", invalid="ignore"):
            rising = np.where(left > 0.0, (u[:, None] - table[: -degree - 1]) / left, 0.0)
            falling = np.where(right > 0.0, (table[degree + 1 :] - u[:, None]) / right, 0.0)
        basis = rising * basis[:, :-1] + falling * basis[:, 1:]
    shares = basis * np.array(weights)
    return tuple(map(tuple, (shares / shares.sum(axis=1, keepdims=True)).tolist()))


def polynomial(coefficients: Sequence[float | Floats], u: Floats) -> Floats:
    """Return a + b u + c u^2 + d u^3."""
    a, b, c, d = coefficients
    return np.asarray(a + u * (b + u * (c + u * d)))


def go_on(pieces: Sequence[Floats], points: Floats, most: int = 6, apart: float = 0.0) -> Floats:
    """Return the points of a piece that are ahead of the last one, without ``most`` at most of them.

    Pieces may not quite meet; over a gap aside, ``apart`` wide, the line goes in 20 times its width.
    """
    if not pieces or len(points) < 2:
        return points
    last = np.concatenate(pieces[-2:])[-2:]
    along = (last[1] - last[0]) / np.hypot(*(last[1] - last[0]))
    least_ahead = 0.25  # way from the end of a piece to the next point [m]
    ahead = (points - last[1]) @ along > least_ahead + 20.0 * apart
    return points[int(ahead.argmax()) if ahead[:most].any() else 0 :]
