"""Temporal operators of a monitor, as cells.

A bounded window is settled by a chain of pairs: two windows of 2^k samples, overlapping or not, make the
wider one. A bounded until or since asks its operands for their newest values. An unbounded past operator
needs only its own last value; an unbounded future one is an obligation: it has a corner axis of its own.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from avrare.logic.cells import Cell, Moment
from avrare.logic.corners import corner
from avrare.logic.terms import align
from avrare.logic.windows import accumulate, neutral, other, sliding, until

if TYPE_CHECKING:
    from avrare.logic.region import Region

Array = NDArray[Any]

FEW = 16
"""Open values up to which monitors without corners compute them one by one, each from the next."""


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

    def _pair(self, region: Region, behind: int = 0) -> tuple[Array, Array]:
        """Both operands' values from ``behind`` samples before the region on."""
        start = max(0, region.start(self) - behind)
        return broadcast(*(region.rows(child, start) for child in self.children))

    def _step(self, left: Array, right: Array, later: Array | None) -> Array:
        """The value of until from that at the next sample, of since from that at the last one."""
        join, meet = self.join, other(self.join)
        if later is None:
            left, right = broadcast(left, right)
            return np.asarray(meet(left, right)) if self.closed else right
        if not left.shape == right.shape == later.shape:
            right, later = align(right, later)
            left, right = align(left, right)
            left, later = align(left, later)
        return np.asarray(meet(left, join(right, later)) if self.closed else join(right, meet(left, later)))

    def _over(self, now: Moment, i: int, samples: Sequence[int]) -> Array:
        """The value at sample ``i`` of an operator with two operands: their samples, farthest first."""
        left, right = self.children
        value = None
        for k in samples:
            if abs(k - i) >= self.lo:
                value = self._step(now.at(left, k), now.at(right, k), value)
            elif value is not None:
                value = np.asarray(other(self.join)(*align(now.at(left, k), value)))
        if value is None:
            like, _ = broadcast(now.at(left, i), now.at(right, i))
            return np.full_like(like, neutral(self.join))
        return value


class Pair(Cell):
    """The operand's values at two samples, ``near`` and ``far`` ones ahead (behind if negative), joined."""

    def __init__(self, join: np.ufunc, child: Cell, near: int, far: int) -> None:
        super().__init__([child], ahead=max(0, far), behind=max(0, -far))
        self.join, self.near, self.far = join, near, far
        self._child = child
        newest = self.delay - child.delay + 1
        self._rows = near - newest, far - newest
        self._first = self.delay - min(0, near, far) if near != far else math.inf

    def settle(self, now: Moment) -> Array:
        """Both from the operand's table, as soon as that goes back far enough."""
        if now.t < self._first:
            return self.value(now, now.t - self.delay)
        near, far = self._rows
        settled = now.tables[self._child.index]
        return self.join(settled[near], settled[far])  # type: ignore[no-any-return]

    def value(self, now: Moment, i: int) -> Array:
        """What there is of the two; neutral if nothing."""
        near, far, child = i + self.near, i + self.far, self._child
        if 0 <= far <= now.t:
            x = now.at(child, far)
            return x if near == far else self.join(now.at(child, near), x)
        if 0 <= near <= now.t:
            return now.at(child, near)
        return np.full_like(now.at(child, i), neutral(self.join))


class Window(Pair):
    """always, eventually, historically and once, bounded: the end of a chain of pairs.

    Args:
        pair: As the last pair of the chain.
        base: The operand, whose samples ``lo`` to ``hi`` away are joined.
        lo: First sample of the window.
        hi: Last sample of the window.
    """

    def __init__(self, pair: Pair, base: Cell, lo: int, hi: int) -> None:
        super().__init__(pair.join, pair.children[0], pair.near, pair.far)
        self.base, self.lo, self.hi, self.past = base, lo, hi, pair.far < 0
        self._few = 0 if self.past or lo else min(hi, FEW)
        base.keep = max(base.keep, hi)

    def value(self, now: Moment, i: int) -> Array:
        """From the pair, or from the next sample's where both windows go to the newest one, not far off."""
        if i <= now.t - self._few:
            return Pair.value(self, now, i)
        x = now.at(self.base, i)
        return x if i == now.t else self.join(x, now.at(self, i + 1))

    def open(self, region: Region) -> Array:
        """Over what there is of the windows."""
        start, count = region.start(self), region.count(self)
        if self.past:
            first = max(0, start - self.hi)
            x = region.rows(self.base, first)
            return sliding(x[::-1], self.lo, self.hi, self.join)[::-1][start - first :]
        x = region.ahead(region.rows(self.base, start), self.hi)
        return sliding(x, self.lo, self.hi, self.join)[:count]


def windowed(join: np.ufunc, lo: int, hi: int, base: Cell, past: bool) -> list[Cell]:
    """The chain of cells that ends with the window."""
    sign, width, covered = -1 if past else 1, hi - lo + 1, 1
    chain: list[Cell] = [base]
    while len(chain) == 1 or covered < width:
        by = min(covered, width - covered)
        offset = lo if covered + by == width else 0
        pair = Pair(join, chain[-1], sign * offset, sign * (offset + by))
        chain.append(pair)
        covered += by
    return [*chain[1:-1], Window(pair, base, lo, hi)]


class PastFold(_Temporal):
    """once and historically, over the whole past."""

    def value(self, now: Moment, i: int) -> Array:
        """The last value and one more."""
        last, value = now.last(self, i), now.at(self.children[0], i)
        return value if last is None else np.asarray(self.join(last, value))

    def open(self, region: Region) -> Array:
        """The settled value and the operand's open ones."""
        x = region.open(self.children[0])
        settled = region.settled(self, 1)
        if settled is None or not len(x):
            return accumulate(self.join, x)
        return accumulate(self.join, join_rows(settled, x))[1:]


class Since(_Temporal):
    """since and trigger, bounded."""

    def value(self, now: Moment, i: int) -> Array:
        """Over the operands' values, oldest first."""
        return self._over(now, i, range(max(0, i - self.hi), i + 1))

    def open(self, region: Region) -> Array:
        """Over the operands' values, settled and open, seen backwards."""
        left, right = self._pair(region, self.hi)
        values = until(left[::-1], right[::-1], self.lo, self.hi, self.closed, self.join)[::-1]
        return values[len(values) - region.count(self) :]


class SinceFold(_Temporal):
    """since and trigger, over the whole past."""

    def value(self, now: Moment, i: int) -> Array:
        """From its last value."""
        left, right = (now.at(child, i) for child in self.children)
        return self._step(left, right, now.last(self, i))

    def open(self, region: Region) -> Array:
        """From its settled value on."""
        left, right = self._pair(region)
        settled = region.settled(self, 1)
        value = None if settled is None else settled[-1]
        values = []
        for l, r in zip(left, right, strict=True):
            value = self._step(l, r, value)
            values.append(value)
        return np.stack(values) if values else left


class Until(_Temporal):
    """until and release, bounded."""

    def value(self, now: Moment, i: int) -> Array:
        """Over the operands' values, newest first; or from the next sample's, as with a window."""
        if not self.lo and i < now.t <= i + self.hi:
            left, right = self.children
            for k in range(now.t if i + self.hi == now.t else i + 1, i, -1):  # recursion is for a few only
                later = now.at(self, k)
            return self._step(now.at(left, i), now.at(right, i), later)
        return self._over(now, i, range(min(i + self.hi, now.t), i - 1, -1))

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

    def value(self, now: Moment, i: int) -> Array:
        """From its value at the next sample, whatever that is."""
        operands = [now.at(child, i) for child in self.children]
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


def broadcast(left: Array, right: Array) -> tuple[Array, Array]:
    """Two operands with all their axes."""
    if left.shape == right.shape:
        return left, right
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
