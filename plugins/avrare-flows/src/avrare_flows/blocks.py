"""Invertible blocks of a flow, from normal to physical numbers, in NumPy.

They compute what Pyro's transforms of the same names compute (Dinh et al. 2017; Durkan et al. 2019; Germain
et al. 2015). Products are einsum without BLAS: no row depends on its neighbours.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from avrare.protocols import Floats

_LEAST, _MOST = -5.0, 3.0
"""Of an affine coupling's log scale."""
_LEAST_BIN, _LEAST_SLOPE, _EPSILON = 1e-3, 1e-3, 1e-6
"""Of a spline's bins (over the width of all) and its slopes; where a bin begins."""

Warped = tuple[Floats, Floats]
"""Rows (N, n), and log |det| (N,) of the map's derivative."""


class Block(Protocol):
    """A step of a flow."""

    def push(self, x: Floats) -> Warped:
        """Rows (N, n) one step nearer to the physical ones, and log |det| (N,)."""


@dataclass(frozen=True, eq=False)
class Network:
    """A perceptron with rectified units.

    Attributes:
        weights: (out, in) of each layer.
        biases: (out,) of each layer.
    """

    weights: tuple[Floats, ...]
    biases: tuple[Floats, ...]

    def __call__(self, x: Floats) -> Floats:
        """(N, out) of (N, in)."""
        for weight, bias in zip(self.weights[:-1], self.biases[:-1], strict=True):
            x = np.maximum(np.einsum("ni,oi->no", x, weight) + bias, 0.0)
        return np.asarray(np.einsum("ni,oi->no", x, self.weights[-1]) + self.biases[-1])


@dataclass(frozen=True, eq=False)
class AffineCoupling:
    """Moves and stretches the last numbers of a row by what the first n // 2 say; then turns the row round.

    Attributes:
        network: From the first numbers to means and log scales of the others.
    """

    network: Network

    def push(self, x: Floats) -> Warped:
        """See ``Block``."""
        kept = x.shape[1] // 2
        mean, log_scale = np.split(self.network(x[:, :kept]), 2, axis=1)
        log_scale = np.clip(log_scale, _LEAST, _MOST)
        moved = np.exp(log_scale) * x[:, kept:] + mean
        return np.concatenate([x[:, :kept], moved], axis=1)[:, ::-1], log_scale.sum(axis=1)


@dataclass(frozen=True, eq=False)
class SplineAutoregressive:
    """Sends each number through a rational quadratic spline that the ones before it choose.

    Attributes:
        network: Masked, from a row to (3 bins - 1) x n parameters.
        bound: Beyond it the spline is the identity.
    """

    network: Network
    bound: float

    def push(self, x: Floats) -> Warped:
        """See ``Block``."""
        raw = self.network(x).reshape(len(x), -1, x.shape[1])
        bins = (raw.shape[1] + 1) // 3
        widths, heights, slopes = np.split(raw.transpose(0, 2, 1), [bins, 2 * bins], axis=2)
        knots = _knots(widths, self.bound), _knots(heights, self.bound)
        return _spline(x, *knots, _LEAST_SLOPE + np.logaddexp(slopes, 0.0), self.bound)


def _knots(raw: Floats, bound: float) -> Floats:
    """(N, n, bins + 1) from -bound to bound."""
    share = np.exp(raw - raw.max(axis=2, keepdims=True))
    share /= share.sum(axis=2, keepdims=True)
    bins = raw.shape[2]
    inner = np.cumsum(_LEAST_BIN + (1.0 - _LEAST_BIN * bins) * share, axis=2)[..., :-1]
    ends = np.full((*raw.shape[:2], 1), bound)
    return np.concatenate([-ends, 2.0 * bound * inner - bound, ends], axis=2)


def _spline(x: Floats, across: Floats, up: Floats, inner: Floats, bound: float) -> Warped:
    """The spline through the knots (across, up), of the slopes ``inner`` (N, n, bins - 1) between them."""
    end = np.full((*x.shape, 1), 1.0 - _LEAST_SLOPE)
    slopes = np.concatenate([end, inner, end], axis=2)
    place = np.clip((x[..., None] >= across + _EPSILON).sum(axis=2) - 1, 0, across.shape[2] - 2)

    def at(values: Floats, offset: int = 0) -> Floats:
        return np.take_along_axis(values, place[..., None] + offset, axis=2)[..., 0]

    width, height = at(across, 1) - at(across), at(up, 1) - at(up)
    chord, first, last = height / width, at(slopes), at(slopes, 1)
    t = (np.clip(x, -bound, bound) - at(across)) / width
    both = t * (1.0 - t)
    below = chord + (first + last - 2.0 * chord) * both
    inside = np.abs(x) <= bound
    value = np.where(inside, at(up) + height * (chord * t**2 + first * both) / below, x)
    rise = chord**2 * (last * t**2 + 2.0 * chord * both + first * (1.0 - t) ** 2)
    log_slope = np.where(inside, np.log(rise) - 2.0 * np.log(below), 0.0)
    return value, log_slope.sum(axis=1)
