"""Laws of a row of noise: independent numbers, or numbers joined by a Gaussian copula."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from avrare.base.errors import UsageError
from avrare.protocols import Floats
from avrare_flows.marginals import Marginal, from_normal, to_normal


class Law(Protocol):
    """Physical noise as a transform of as many standard normal numbers.

    Attributes:
        noise_size: Number of numbers of a row.
        note: Reason to doubt the law; empty where it is exact.
    """

    @property
    def noise_size(self) -> int: ...  # noqa: D102

    @property
    def note(self) -> str: ...  # noqa: D102

    def physical(self, z: Floats) -> Floats:
        """Return physical rows (N, noise_size) of standard normal rows."""


class Joint:
    """One law for each number of a row (an isoprobabilistic transform, after Nataf): exact, no weights.

    Args:
        laws: Law of each number.
        correlation: (n, n) correlation of the underlying normal numbers, a Gaussian copula; None:
            independent. The correlation of the physical numbers is a little smaller, their rank correlation
            is 6/pi asin(r/2).

    Raises:
        UsageError: The correlation is not a correlation matrix, or has another size.
    """

    note = ""

    def __init__(self, laws: Sequence[Marginal], correlation: ArrayLike | None = None) -> None:
        self.laws = tuple(laws)
        self.noise_size = len(self.laws)
        self.correlation = None if correlation is None else _check_correlation(correlation, self.noise_size)

    def physical(self, z: Floats) -> Floats:
        """Return physical rows (N, noise_size) of standard normal rows."""
        columns = list(z.T)
        if self.correlation is not None:
            columns = _times(np.asarray(np.linalg.cholesky(self.correlation)), columns)
        physical_columns = [from_normal(law, column) for law, column in zip(self.laws, columns, strict=True)]
        return np.ascontiguousarray(np.stack(physical_columns, axis=1))

    def warp(self, z: Floats) -> tuple[Floats, Floats]:
        """Return physical rows (N, noise_size) of standard normal rows, and log |det| (N,) of the derivative.

        Raises:
            UsageError: A law has atoms.
        """
        x = self.physical(z)
        return x, log_normal_density(z) - self.log_density(x)

    def log_density(self, x: Floats) -> Floats:
        """Return the logarithm (N,) of the density at rows (N, noise_size).

        Raises:
            UsageError: A law has atoms.
        """
        pairs = list(zip(self.laws, x.T, strict=True))
        total = np.asarray(sum(law.log_density(column) for law, column in pairs))
        if self.correlation is None:
            return total
        score = [to_normal(law, column) for law, column in pairs]
        excess = np.asarray(np.linalg.inv(self.correlation)) - np.eye(self.noise_size)
        tilted = _times(excess, score)
        square = np.asarray(sum(a * b for a, b in zip(score, tilted, strict=True)))
        return np.asarray(total - 0.5 * square - 0.5 * np.linalg.slogdet(self.correlation)[1])


def log_normal_density(z: Floats) -> Floats:
    """Return the log density (N,) of standard normal rows (N, n)."""
    square = np.asarray(sum(column**2 for column in z.T))
    return np.asarray(-0.5 * square - 0.5 * z.shape[1] * math.log(2.0 * math.pi))


def _times(matrix: Floats, columns: Sequence[Floats]) -> list[Floats]:
    # Added up one by one: no row depends on its neighbours.
    return [
        np.asarray(sum(weight * column for weight, column in zip(row, columns, strict=True) if weight != 0.0))
        for row in matrix
    ]


def _check_correlation(correlation: ArrayLike, size: int) -> Floats:
    matrix = np.asarray(correlation, dtype=np.float64)
    if matrix.shape != (size, size):
        raise UsageError(f"correlation has shape {matrix.shape}, but there are {size} laws")
    good = np.array_equal(matrix, matrix.T) and np.array_equal(np.diag(matrix), np.ones(size))
    if not good or np.linalg.eigvalsh(matrix).min() <= 0.0:
        raise UsageError("correlation must be symmetric, positive definite, and 1 on its diagonal")
    return matrix
