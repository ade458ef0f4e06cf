"""Laws of random numbers, each a map from a standard normal number to a drawn value.

A law is known by two increasing functions that are inverse to each other: ``at(z)`` is F^-1(Φ(z)), and
``score(x)`` is Φ^-1(F(x)), the normal score of a value. Both keep their precision in either tail, since no
probability close to 1 is ever formed.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from typing import Annotated, Literal, Self, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import BaseModel, ConfigDict, Field, model_validator

Floats: TypeAlias = NDArray[np.float64]
Positive = Annotated[float, Field(gt=0.0)]

MOST_VALUES = 1001
"""Most values that an empirical law keeps; a longer column is kept as this many quantiles."""


class _Law(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    @abstractmethod
    def at(self, z: ArrayLike) -> Floats:
        """Return the value that stands where ``z`` stands in a standard normal distribution."""

    @abstractmethod
    def score(self, value: ArrayLike) -> Floats:
        """Return the standard normal number that stands where ``value`` stands in this law."""


class Normal(_Law):
    """Normal distribution."""

    law: Literal["normal"]
    mean: float = Field(description="mean of the value")
    sd: float = Field(gt=0.0, description="standard deviation of the value")

    def at(self, z: ArrayLike) -> Floats:
        """Return the value of a standard normal number."""
        return np.asarray(self.mean + self.sd * np.asarray(z, dtype=np.float64))

    def score(self, value: ArrayLike) -> Floats:
        """Return the normal score of a value."""
        return np.asarray((np.asarray(value, dtype=np.float64) - self.mean) / self.sd)


class Lognormal(_Law):
    """Distribution of a positive value whose logarithm is normal."""

    law: Literal["lognormal"]
    mean: float = Field(gt=0.0, description="mean of the value, not of its logarithm")
    sd: float = Field(gt=0.0, description="standard deviation of the value, not of its logarithm")

    def _log(self) -> tuple[float, float]:
        variance = math.log1p((self.sd / self.mean) ** 2)
        return math.log(self.mean) - 0.5 * variance, math.sqrt(variance)

    def at(self, z: ArrayLike) -> Floats:
        """Return the value of a standard normal number."""
        centre, spread = self._log()
        return np.asarray(np.exp(centre + spread * np.asarray(z, dtype=np.float64)))

    def score(self, value: ArrayLike) -> Floats:
        """Return the normal score of a value."""
        centre, spread = self._log()
        with np.errstate(divide="ignore"):
            return np.asarray((np.log(np.maximum(value, 0.0)) - centre) / spread)


class Uniform(_Law):
    """Uniform distribution."""

    law: Literal["uniform"]
    low: float = Field(description="least value")
    high: float = Field(description="greatest value")

    @model_validator(mode="after")
    def _require_order(self) -> Self:
        _check_order(self.low, self.high)
        return self

    def at(self, z: ArrayLike) -> Floats:
        """Return the value of a standard normal number."""
        number = np.asarray(z, dtype=np.float64)
        near, share = np.where(number < 0.0, self.low, self.high), _normal_cdf(-np.abs(number))
        return np.asarray(near + np.where(number < 0.0, 1.0, -1.0) * (self.high - self.low) * share)

    def score(self, value: ArrayLike) -> Floats:
        """Return the normal score of a value."""
        number, width = np.asarray(value, dtype=np.float64), self.high - self.low
        share = np.clip((number - self.low) / width, 0.0, 1.0)
        left = np.clip((self.high - number) / width, 0.0, 1.0)
        return _number_at(share, left)


class Truncated(_Law):
    """Another law, given that its value lies between two bounds."""

    law: Literal["truncated"]
    of: Law = Field(description="the law whose values are kept")
    low: float | None = Field(default=None, description="least value; none: no lower bound")
    high: float | None = Field(default=None, description="greatest value; none: no upper bound")

    @model_validator(mode="after")
    def _check_rest(self) -> Self:
        if self.low is None and self.high is None:
            raise ValueError("give low, high or both: where the law is cut")
        _check_order(self.low, self.high)
        low, high = self._bounds()
        if not _normal_cdf(low) < _normal_cdf(high) and not _normal_cdf(-high) < _normal_cdf(-low):
            raise ValueError("the law has no values between low and high")
        return self

    def _bounds(self) -> tuple[float, float]:
        low, high = self.low, self.high
        if len(_steps(self.of)):  # the score of a value is the middle of its share, and all of it is kept
            low = None if low is None else math.nextafter(low, -math.inf)
            high = None if high is None else math.nextafter(high, math.inf)
        return (
            -math.inf if low is None else float(self.of.score(low)),
            math.inf if high is None else float(self.of.score(high)),
        )

    def at(self, z: ArrayLike) -> Floats:
        """Return the value of a standard normal number."""
        low, high = self._bounds()
        number = np.asarray(z, dtype=np.float64)
        # In the half that has the smaller probabilities, so that a far tail keeps its digits.
        share, left = _normal_cdf(number), _normal_cdf(-number)
        if low > 0.0:
            inner = -_number(_normal_cdf(-low) * left + _normal_cdf(-high) * share)
        else:
            inner = _number_at(
                _normal_cdf(low) * left + _normal_cdf(high) * share,
                _normal_cdf(-low) * left + _normal_cdf(-high) * share,
            )
        least = math.nextafter(low, math.inf) if len(_steps(self.of)) else low  # not a border
        bounds = -math.inf if self.low is None else self.low, math.inf if self.high is None else self.high
        return np.clip(self.of.at(np.clip(inner, least, high)), *bounds)

    def score(self, value: ArrayLike) -> Floats:
        """Return the normal score of a value."""
        low, high = self._bounds()
        inner = np.clip(self.of.score(value), low, high)
        above = _normal_cdf(-low) - _normal_cdf(-high), _normal_cdf(-inner) - _normal_cdf(-high)
        below = _normal_cdf(high) - _normal_cdf(low), _normal_cdf(inner) - _normal_cdf(low)
        whole = max(above[0], below[0])
        return _number_at(np.clip(below[1] / whole, 0.0, 1.0), np.clip(above[1] / whole, 0.0, 1.0))


class Part(BaseModel):
    """One law of a mixture and how much of the values it gives."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    weight: Positive = Field(description="share of the values, in proportion to the other parts'")
    of: Law = Field(description="the law of this part")


class Mixture(_Law):
    """Value of one of several laws, chosen by their weights."""

    law: Literal["mixture"]
    parts: tuple[Part, ...] = Field(min_length=2, max_length=50, description="laws with their weights")

    def at(self, z: ArrayLike) -> Floats:
        """Return the value of a standard normal number, by bisection between the parts' own values."""
        number = np.asarray(z, dtype=np.float64)
        values = np.stack([part.of.at(number) for part in self.parts])
        low, high = values.min(axis=0), values.max(axis=0)
        for _ in range(64):  # beyond the last bit of a bracket
            middle = 0.5 * (low + high)
            under = self.score(middle) < number
            low, high = np.where(under, middle, low), np.where(under, high, middle)
        if len(steps := _steps(self)):  # a step between the two is the value itself, not one a bit beside it
            near = steps[np.minimum(np.searchsorted(steps, low), len(steps) - 1)]
            high = np.where((low <= near) & (near <= high), near, high)
        return np.asarray(high)

    def score(self, value: ArrayLike) -> Floats:
        """Return the normal score of a value."""
        weights = np.array([part.weight for part in self.parts])
        scores = np.stack([part.of.score(value) for part in self.parts])
        shape = (-1, *(1,) * (scores.ndim - 1))
        share = (weights / weights.sum()).reshape(shape)
        return _number_at(
            (share * _normal_cdf(scores)).sum(axis=0), (share * _normal_cdf(-scores)).sum(axis=0)
        )


class Empirical(_Law):
    """Values that were seen: the quantiles between them are joined by straight lines.

    In a scenario the values are ``file`` and ``column``, a CSV file beside it, or ``values``.
    """

    law: Literal["empirical"]
    values: tuple[float, ...] = Field(
        min_length=2, description="values that were seen, in any order; or give file and column"
    )

    @model_validator(mode="after")
    def _check_spread(self) -> Self:
        if min(self.values) == max(self.values):
            raise ValueError("all values are the same: write the number itself")
        return self

    def _sort(self) -> tuple[Floats, Floats]:
        values = np.sort(np.array(self.values))
        return values, np.linspace(0.0, 1.0, len(values))

    def at(self, z: ArrayLike) -> Floats:
        """Return the value of a standard normal number."""
        values, places = self._sort()
        return np.asarray(np.interp(_normal_cdf(np.asarray(z, dtype=np.float64)), places, values))

    def score(self, value: ArrayLike) -> Floats:
        """Return the normal score of a value; of a value that was seen often, the middle of its scores."""
        values, places = self._sort()
        number = np.asarray(value, dtype=np.float64)
        first, last = np.searchsorted(values, number), np.searchsorted(values, number, side="right") - 1
        middle = 0.5 * (places[np.minimum(first, len(values) - 1)] + places[last])
        share = np.where(first < last, middle, np.interp(number, values, places))
        return _number_at(share, 1.0 - share)


class Discrete(_Law):
    """One of a few values, each with a weight."""

    law: Literal["discrete"]
    values: tuple[float, ...] = Field(min_length=2, max_length=1000, description="the values, ascending")
    weights: tuple[Positive, ...] = Field(description="share of each value, in proportion to the others'")

    @model_validator(mode="after")
    def _check_consistency(self) -> Self:
        if len(self.weights) != len(self.values):
            raise ValueError(f"{len(self.values)} values need as many weights, not {len(self.weights)}")
        if list(self.values) != sorted(set(self.values)):
            raise ValueError("values must ascend")
        return self

    def _shares(self) -> tuple[Floats, Floats]:
        # Probabilities of at most each value but the last, and of more.
        weights = np.array(self.weights) / max(self.weights)
        weights /= math.fsum(weights)
        return np.cumsum(weights)[:-1], np.cumsum(weights[::-1])[::-1][1:]

    def at(self, z: ArrayLike) -> Floats:
        """Return the value of a standard normal number."""
        edges = _number_at(*self._shares())
        return np.array(self.values)[np.searchsorted(edges, np.asarray(z, dtype=np.float64))]

    def score(self, value: ArrayLike) -> Floats:
        """Return the normal score of a value: the middle of its share, or a border between two."""
        below, above = self._shares()
        lower, upper = np.concatenate([[0.0], below]), np.concatenate([above, [0.0]])
        at, left = np.concatenate([below, [1.0]]), np.concatenate([[1.0], above])
        number, values = np.asarray(value, dtype=np.float64), np.array(self.values)
        k = np.searchsorted(values, number)
        place = np.minimum(k, len(values) - 1)
        middle = _number_at(0.5 * (lower + at)[place], 0.5 * (upper + left)[place])
        border = _number_at(np.append(lower, 1.0)[k], np.append(left, 0.0)[k])
        return np.where(values[place] == number, middle, border)


def _steps(law: _Law) -> Floats:
    """Return the values that have positive probability under a law, in ascending order."""
    if isinstance(law, Mixture):
        return np.unique(np.concatenate([_steps(part.of) for part in law.parts]))
    if isinstance(law, Truncated):
        return _steps(law.of)
    if isinstance(law, Empirical):
        values, times = np.unique(law.values, return_counts=True)
        return np.asarray(values[times > 1])
    return np.array(law.values if isinstance(law, Discrete) else ())


Law: TypeAlias = Annotated[
    Normal | Lognormal | Uniform | Truncated | Mixture | Empirical | Discrete, Field(discriminator="law")
]
for _kind in (Truncated, Part, Mixture):
    _kind.model_rebuild()


def condense(values: Floats) -> Floats:
    """Return at most ``MOST_VALUES`` values with the same quantiles."""
    if len(values) <= MOST_VALUES:
        return values
    return np.asarray(np.quantile(values, np.linspace(0.0, 1.0, MOST_VALUES)))


def _check_order(low: float | None, high: float | None) -> None:
    if low is not None and high is not None and low >= high:
        raise ValueError(f"low ({low:g}) must be below high ({high:g})")


def _normal_cdf(z: ArrayLike) -> Floats:
    from scipy.special import ndtr

    return np.asarray(ndtr(np.asarray(z, dtype=np.float64)))


def _number(share: ArrayLike) -> Floats:
    from scipy.special import ndtri

    return np.asarray(ndtri(np.asarray(share, dtype=np.float64)))


def _number_at(share: ArrayLike, left: ArrayLike) -> Floats:
    # Φ^-1 from the probability below and the one above, of which the smaller has the digits.
    share, left = np.asarray(share), np.asarray(left)
    return np.where(share <= left, _number(np.minimum(share, 0.5)), -_number(np.minimum(left, 0.5)))
