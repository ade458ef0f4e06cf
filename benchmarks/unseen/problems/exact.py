"""Tools for exact probabilities: Gaussian quadrature, densities carried through time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from .case import Floats

ORDER = 8
"""Order of every quadrature; truths.py raises it to see what an answer is worth."""
Grid = tuple[Floats, Floats]
Density = Callable[[Floats, Floats, int], Floats]
"""Function from positions, positions before and regime to the density of a step."""


def gauss(edges: Sequence[float] | Floats) -> Grid:
    """Return nodes and weights of Gauss-Legendre panels between edges."""
    ends = np.unique(np.asarray(edges, float))
    x, w = np.polynomial.legendre.leggauss(ORDER)
    half = (ends[1:] - ends[:-1])[:, None] / 2
    return (ends[:-1, None] + half * (1 + x)).ravel(), (half * w).ravel()


def panels(low: float, high: float, width: float, *breaks: float) -> Grid:
    """Return the grid of panels of about a width, which ends at every break, too."""
    inner = [b for b in breaks if low < b < high]
    return gauss([*np.linspace(low, high, int((high - low) / width) + 2), *inner])


def bell(x: Floats, mean: Floats | float = 0.0, scale: Floats | float = 1.0) -> Floats:
    """Return the normal density."""
    return np.exp(-0.5 * ((x - mean) / scale) ** 2) / (scale * np.sqrt(2 * np.pi))


def survival(
    density: Density,
    grid: Grid,
    steps: int,
    switches: Sequence[Sequence[float]] | Floats = ((1.0,),),
    shares: Sequence[float] | Floats = (1.0,),
    label: Callable[[int, Floats], Floats] | None = None,
    start: float = 0.0,
) -> Floats:
    """Return P(the position stays on the grid until t), t = 0..steps.

    Args:
        density: Of a step in each regime.
        grid: Nodes and weights of the safe positions.
        steps: Number of steps.
        switches: Probabilities of the regime (column) that a step moves in, by the regime before (row).
        shares: Probabilities of the first regimes; regimes left out have none.
        label: Function from the regime of a step and the positions after it to the regimes then; -1 fails.
        start: First position.
    """
    x, w = grid
    matrix = np.asarray(switches, float)
    regimes = range(len(matrix))
    kernels = np.stack([density(x[:, None], x, k) * w for k in regimes])
    first = np.pad(np.asarray(shares, float), (0, len(matrix) - len(shares))) @ matrix
    parts = np.stack([first[k] * density(x, np.float64(start), k) for k in regimes])
    curve = [1.0]
    for _ in range(steps):
        if label is not None:
            labels = np.stack([np.broadcast_to(label(k, x), x.shape) for k in regimes])
            parts = np.stack([np.where(labels == k, parts, 0.0).sum(0) for k in regimes])
        curve.append(float((parts * w).sum()))
        parts = np.einsum("kij,kj->ki", kernels, matrix.T @ parts)
    return np.array(curve)


def loss(density: Density, grid: Grid, steps: int, *more: Any, **options: Any) -> float:
    """Return P(the position leaves the grid within the steps); further arguments are those of survival."""
    return float(1 - survival(density, grid, steps, *more, **options)[-1])
