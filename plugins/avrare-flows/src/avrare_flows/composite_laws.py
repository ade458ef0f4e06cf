"""Laws made of laws: truncated, mixed, the beam model of range sensors, and any law of SciPy."""

# ruff: noqa: D102 - ``Marginal`` documents the methods of all laws.

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from avrare.base.errors import UsageError
from avrare.protocols import Floats
from avrare_flows.marginals import Exponential, Marginal, Normal, Number, Tails, Uniform


@dataclass(frozen=True, eq=False)
class Truncated:
    """A law restricted to (low, high].

    Raises:
        UsageError: The interval has probability 0.
    """

    law: Marginal
    low: Number = -np.inf
    high: Number = np.inf

    def __post_init__(self) -> None:
        if not np.all(self._cut()[2] > 0.0):
            raise UsageError(
                f"{type(self.law).__name__} has no probability between {self.low} and {self.high}"
            )

    def _cut(self) -> tuple[Floats, Floats, Floats]:
        """Return P(X <= low), P(X > high) and the rest, without cancellation in a tail."""
        below, above_low = self.law.tails(np.asarray(self.low, dtype=np.float64))
        below_high, above = self.law.tails(np.asarray(self.high, dtype=np.float64))
        middle = np.where(
            below >= above_low,
            above_low - above,
            np.where(below_high <= above, below_high - below, 1.0 - below - above),
        )
        return below, above, middle

    def quantile(self, lower: Floats, upper: Floats) -> Floats:
        below, above, middle = self._cut()
        values = self.law.quantile(below + lower * middle, above + upper * middle)
        return np.clip(values, self.low, self.high)

    def tails(self, x: Floats) -> Tails:
        below, above, middle = self._cut()
        lower, upper = self.law.tails(np.clip(x, self.low, self.high))
        return np.clip((lower - below) / middle, 0.0, 1.0), np.clip((upper - above) / middle, 0.0, 1.0)

    def log_density(self, x: Floats) -> Floats:
        inside = np.greater(x, self.low) & np.less_equal(x, self.high)
        return np.where(inside, self.law.log_density(x) - np.log(self._cut()[2]), -np.inf)


@dataclass(frozen=True, eq=False)
class Point:
    """A single number, an atom of a mixture; it has no density."""

    value: Number = 0.0

    def quantile(self, lower: Floats, upper: Floats) -> Floats:
        return np.asarray(self.value + np.zeros(np.shape(lower)))

    def tails(self, x: Floats) -> Tails:
        reached = np.greater_equal(x, self.value)
        return reached.astype(np.float64), (~reached).astype(np.float64)

    def log_density(self, x: Floats) -> Floats:
        raise UsageError("a law with atoms has no density", "weights need a density: leave the atom out")


@dataclass(frozen=True, eq=False)
class Mixture:
    """Mixture of several laws.

    Attributes:
        weights: Weight of each law; they are divided by their sum.
        laws: The laws.
    """

    weights: tuple[float, ...]
    laws: tuple[Marginal, ...]

    def __post_init__(self) -> None:
        weights = np.asarray(self.weights, dtype=np.float64)
        if len(weights) != len(self.laws) or not (weights >= 0.0).all() or not weights.sum() > 0.0:
            raise UsageError("a mixture needs one weight for each law, none negative and not all 0")

    @property
    def _parts(self) -> list[tuple[float, Marginal]]:
        total = sum(self.weights)
        pairs = zip(self.weights, self.laws, strict=True)
        return [(weight / total, law) for weight, law in pairs if weight > 0.0]

    def quantile(self, lower: Floats, upper: Floats) -> Floats:
        # Bisection between the parts' quantiles, to the last bit.
        ends = np.stack(np.broadcast_arrays(*(law.quantile(lower, upper) for _, law in self._parts)))
        low, high = ends.min(axis=0), ends.max(axis=0)
        while True:
            middle = low + 0.5 * (high - low)
            moving = (middle > low) & (middle < high)
            if not moving.any():
                return np.asarray(high)
            below, above = self.tails(middle)
            reached = np.where(lower <= upper, below >= lower, above <= upper)
            high = np.where(moving & reached, middle, high)
            low = np.where(moving & ~reached, middle, low)

    def tails(self, x: Floats) -> Tails:
        parts = [(weight, law.tails(x)) for weight, law in self._parts]
        return (
            np.asarray(sum(weight * tails[0] for weight, tails in parts)),
            np.asarray(sum(weight * tails[1] for weight, tails in parts)),
        )

    def log_density(self, x: Floats) -> Floats:
        logs = [np.log(weight) + law.log_density(x) for weight, law in self._parts]
        return np.asarray(np.logaddexp.reduce(np.stack(np.broadcast_arrays(*logs)), axis=0))


@dataclass(frozen=True, eq=False)
class Scipy:
    """A frozen distribution of ``scipy.stats``, for instance ``Scipy(scipy.stats.skewnorm(4))``."""

    distribution: Any

    def quantile(self, lower: Floats, upper: Floats) -> Floats:
        left = lower <= upper
        values = np.empty(np.shape(lower))
        values[left] = self.distribution.ppf(lower[left])
        values[~left] = self.distribution.isf(upper[~left])
        return values

    def tails(self, x: Floats) -> Tails:
        return np.asarray(self.distribution.cdf(x)), np.asarray(self.distribution.sf(x))

    def log_density(self, x: Floats) -> Floats:
        return np.asarray(self.distribution.logpdf(x))


def beam(
    distance: Number,
    most: Number,
    *,
    std: Number,
    decay: Number,
    hit: float,
    short: float = 0.0,
    nothing: float = 0.0,
    anything: float = 0.0,
) -> Mixture:
    """Return the law of a range sensor's readings (beam model of Thrun, Burgard and Fox, section 6.3).

    Args:
        distance: Distance of the target [m].
        most: Range of the sensor, its reading without a target [m].
        std: Standard deviation of the readings of the target [m]; they are restricted to (0, most].
        decay: Mean reading of nearer obstacles, exponential and restricted to (0, distance] [m].
        hit: Weight of the readings of the target.
        short: Weight of the readings of nearer obstacles.
        nothing: Weight of ``most`` itself, an atom.
        anything: Weight of the readings that are uniform on [0, most].
    """
    about = Truncated(Normal(distance, std), 0.0, most)
    between = Truncated(Exponential(decay), 0.0, distance)
    return Mixture((hit, short, nothing, anything), (about, between, Point(most), Uniform(0.0, most)))
