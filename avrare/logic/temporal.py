"""Temporal operators of a monitor, as cells.

A bounded operator asks its operands for their newest values. An unbounded past operator needs only its own
last value; an unbounded future one is an obligation: it has a corner axis of its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from avrare.logic.cells import Cell, Moment
from avrare.logic.corners import corner
from avrare.logic.terms import align
from avrare.logic.windows import accumulate, neutral, other, sliding, until, until_first

if TYPE_CHECKING:
    from avrare.logic.region import Region

Array = NDArray[Any]


class _Temporal(Cell):
    """An operator whose witnesses are joined by ``join``, ``lo`` to ``hi`` samples away."""

    def __init__(
        self,
        join: np.ufunc,
        children: Sequence[Cell],
        bounds: tuple[int, int] = (0, 0),
        *,
        past: bool = False,
        closed: bool = True,
    ) -> None:
        self.lo, self.hi = bounds
        super().__init__(children, ahead=0 if past else self.hi, behind=self.hi if past else 0)
        self.join, self.closed = join, closed

    def _own(self, now: Moment) -> float | Array:
        """Its last value, or the neutral one."""
        return neutral(self.join) if now.before is None else now.before[-1]

    def _pair(self, region: Region, behind: int = 0) -> tuple[Array, Array]:
        """Both operands' values from ``behind`` samples before the region on."""
        start = max(0, region.start(self) - behind)
        return broadcast(*(region.rows(child, start) for child in self.children))

    def _step(self, left: Array, right: Array, later: Any) -> Array:
        """The value of until from that at the next sample, of since from that at the last one."""
        meet = other(self.join)
        later = later if isinstance(later, np.ndarray) else np.full_like(right, later)
        if self.closed:
            right, later = align(right, later)
            return np.asarray(meet(*align(left, self.join(right, later))))
        return np.asarray(self.join(*align(right, meet(*align(left, later)))))


class PastWindow(_Temporal):
    """once and historically, bounded."""

    def settle(self, now: Moment) -> Array:
        """Over the operand's newest values."""
        (child,) = self.children
        values = now.between(child, self.delay + self.hi, self.delay + self.lo)
        return over(self.join, values, now.at(child, child.delay))

    def open(self, region: Region) -> Array:
        """Over the operand's values, settled and open."""
        start = region.start(self)
        first = max(0, start - self.hi)
        x = region.rows(self.children[0], first)
        return sliding(x[::-1], self.lo, self.hi, self.join)[::-1][start - first :]


class PastFold(_Temporal):
    """once and historically, over the whole past."""

    def settle(self, now: Moment) -> Array:
        """The last value and one more."""
        (child,) = self.children
        value = now.at(child, self.delay)
        return value if now.before is None else np.asarray(self.join(now.before[-1], value))

    def open(self, region: Region) -> Array:
        """The settled value and the operand's open ones."""
        x = region.open(self.children[0])
        settled = region.settled(self, 1)
        if settled is None or not len(x):
            return accumulate(self.join, x)
        return accumulate(self.join, join_rows(settled, x))[1:]


class Since(_Temporal):
    """since and trigger, bounded."""

    def settle(self, now: Moment) -> Array:
        """Over the operands' newest values, seen backwards."""
        back = self.delay + self.hi
        left, right = broadcast(*(now.between(child, back, self.delay) for child in self.children))
        return until_first(left[::-1], right[::-1], self.lo, self.closed, self.join)

    def open(self, region: Region) -> Array:
        """Over the operands' values, settled and open, seen backwards."""
        left, right = self._pair(region, self.hi)
        values = until(left[::-1], right[::-1], self.lo, self.hi, self.closed, self.join)[::-1]
        return values[len(values) - region.count(self) :]


class SinceFold(_Temporal):
    """since and trigger, over the whole past."""

    def settle(self, now: Moment) -> Array:
        """From its last value."""
        left, right = (now.at(child, self.delay) for child in self.children)
        return self._step(left, right, self._own(now))

    def open(self, region: Region) -> Array:
        """From its settled value on."""
        left, right = self._pair(region)
        settled = region.settled(self, 1)
        value: Any = neutral(self.join) if settled is None else settled[-1]
        values = []
        for l, r in zip(left, right, strict=True):
            value = self._step(l, r, value)
            values.append(value)
        return np.stack(values) if values else left


class FutureWindow(_Temporal):
    """always and eventually, bounded."""

    def settle(self, now: Moment) -> Array:
        """Over the operand's newest values."""
        (child,) = self.children
        values = now.between(child, self.delay - self.lo, self.delay - self.hi)
        return over(self.join, values, now.at(child, child.delay))

    def open(self, region: Region) -> Array:
        """Over what there is of the window."""
        x = region.ahead(region.rows(self.children[0], region.start(self)), self.hi)
        return sliding(x, self.lo, self.hi, self.join)[: region.count(self)]


class Until(_Temporal):
    """until and release, bounded."""

    def settle(self, now: Moment) -> Array:
        """Over the operands' newest values."""
        back, to = self.delay, self.delay - self.hi
        left, right = broadcast(*(now.between(child, back, to) for child in self.children))
        return until_first(left, right, self.lo, self.closed, self.join)

    def open(self, region: Region) -> Array:
        """Over what there is of the window."""
        left, right = (region.ahead(x, self.hi) for x in self._pair(region))
        return until(left, right, self.lo, self.hi, self.closed, self.join)[: region.count(self)]


class Obligation(_Temporal):
    """An unbounded future operator: always and eventually with one operand, until and release with two."""

    def bind(self, axis: int, count: int) -> None:
        """Make it the obligation with corner axis ``axis`` out of ``count``."""
        self.obligation = axis
        self.depends |= {axis}
        self._corner = corner(axis, count)

    def settle(self, now: Moment) -> Array:
        """From its value at the next sample, whatever that is."""
        operands = [now.at(child, self.delay) for child in self.children]
        if len(operands) == 1:
            return np.asarray(self.join(*align(operands[0], self._corner)))
        later = self._corner.reshape(self._corner.shape + (1,) * (operands[1].ndim - self._corner.ndim))
        return self._step(operands[0], operands[1], later)

    def open(self, region: Region) -> Array:
        """To the end of what there is."""
        if len(self.children) == 1:
            return sliding(region.open(self.children[0]), 0, np.inf, self.join)
        left, right = self._pair(region)
        return until(left, right, 0, np.inf, self.closed, self.join) if len(left) else left


def over(join: np.ufunc, values: Array, like: Array) -> Array:
    """The values joined along time; neutral, shaped as ``like``, where there are none."""
    if not len(values):
        return np.full_like(like, neutral(join))
    return values[0] if len(values) == 1 else np.asarray(join.reduce(values, axis=0))


def broadcast(left: Array, right: Array) -> tuple[Array, Array]:
    """Two operands with all their axes."""
    left, right = np.broadcast_arrays(*align(left, right))
    return left, right


def join_rows(settled: Array, rows: Array) -> Array:
    """Values one after the other, which may differ in axes that broadcast."""
    ndim = max(settled.ndim, rows.ndim)
    settled, rows = (x.reshape(x.shape + (1,) * (ndim - x.ndim)) for x in (settled, rows))
    shape = np.broadcast_shapes(settled.shape[1:], rows.shape[1:])
    both = np.empty((len(settled) + len(rows), *shape))
    both[: len(settled)], both[len(settled) :] = settled, rows
    return both
