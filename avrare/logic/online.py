"""Following a formula one sample at a time."""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from avrare.logic import formula as f
from avrare.logic.algebra import Robustness, Signed, Truth, flush
from avrare.logic.cells import Moment
from avrare.logic.corners import compose
from avrare.logic.plan import Plan, make_plan
from avrare.logic.region import Region, Tail, make_tail
from avrare.logic.robustness import Evaluator, require_scalar
from avrare.logic.samples import read_sample
from avrare.protocols import Bools, Floats, Signals, Verdict

if TYPE_CHECKING:
    from avrare.logic.api import Formula

Array = NDArray[Any]
_SIGNED, _APART = (Signed(),), (Robustness(), Truth())


@dataclass(frozen=True)
class Carried:
    """What is carried from sample to sample: arrays with leading axis N.

    Attributes:
        tables: Per cell, its newest settled values (N, K, ...) that are still needed.
        leaves: Per leaf, what it folded so far.
    """

    tables: tuple[Array | None, ...]
    leaves: tuple[tuple[Array, ...] | None, ...]


@dataclass(frozen=True)
class MonitorState:
    """A monitor's state: a value that is copied with its particle.

    Attributes:
        t: Samples seen; the same for all particles of a batch.
        carried: Of the margins; a second one of the truth where the margins' signs do not tell it.
        robustness: (N,) of the samples so far.
        violated: (N,) of the samples so far.
        score: (N,) running maximum of minus the robustness.
        newest: (N,) for ``always φ``: the robustness of φ at the newest sample; else None.
    """

    t: int
    carried: tuple[Carried, ...]
    robustness: Floats
    violated: Bools
    score: Floats
    newest: Floats | None


class Follower:
    """The engine of monitors: settles every cell of a formula's plan at each sample.

    One pass gives robustness and truth, except under iff and xor: those need a pass for each.

    Args:
        node: The formula.
        closed: The reading of until and since.
    """

    def __init__(self, node: f.Node, closed: bool) -> None:
        self.closed = closed
        self.plan: Plan = make_plan(node, closed)
        apart = any(isinstance(x, f.Connective) and x.op in ("iff", "xor") for x in f.walk(node))
        self.algebras: tuple[Robustness, ...] = _APART if apart else _SIGNED

    def start(self) -> tuple[Carried, ...]:
        """Before sample 0."""
        nothing = Carried((None,) * len(self.plan.cells), (None,) * len(self.plan.leaves))
        return (nothing,) * len(self.algebras)

    def advance(
        self, carried: tuple[Carried, ...], sample: Mapping[str, Array], t: int, rows: int
    ) -> tuple[tuple[Carried, ...], list[tuple[Moment, list[Any]]]]:
        """Carried after sample ``t``, and per algebra what the cells and the leaves know."""
        n, cells = len(self.plan.obligations), len(self.plan.cells)
        new, seen = [], []
        for algebra, before in zip(self.algebras, carried, strict=True):
            now = Moment(t, rows, sample, algebra, n, [None] * cells, None, [None] * n)
            tables = self._settle(now, before.tables)
            folded = [_corners_first(x, n) for x in before.leaves] if n else before.leaves
            leaves = [leaf.settle(now, x) for leaf, x in zip(self.plan.leaves, folded, strict=True)]
            new.append(Carried(tables, tuple(_rows_first(x, n) for x in leaves) if n else tuple(leaves)))
            seen.append((now, leaves))
        return tuple(new), seen

    def value(self, now: Moment, leaves: list[Any], tail: Tail | None = None) -> Array:
        """The formula's value as things stand: (N,), or its bounds (2, N)."""
        region = Region(now, self.plan.obligations, tail)
        values = [leaf.value(region, x) for leaf, x in zip(self.plan.leaves, leaves, strict=True)]
        value = values[0]
        if not isinstance(self.plan.skeleton, f.Slot):
            slots = [value[None] for value in values]
            value = Evaluator({}, 1, now.rows, region.algebra, self.closed, slots)(self.plan.skeleton)[0]
        shape = (2, now.rows) if tail else (now.rows,)
        require_scalar(value.ndim - len(shape))
        return value if value.shape == shape else np.broadcast_to(value, shape)

    def tail(self, seen: int, length: int | None) -> Tail:
        """The samples to come."""
        return make_tail(seen, self.plan.settling, self.plan.reach, length)

    def _settle(self, now: Moment, before: tuple[Array | None, ...]) -> tuple[Array | None, ...]:
        """Settle all cells; the tables to carry on."""
        kept: list[Array | None] = []
        for cell, table in zip(self.plan.cells, before, strict=True):
            if now.t < cell.delay:
                kept.append(None)
                continue
            now.before = None if table is None else _time_first(table, now.n)
            if cell.obligation is not None:
                now.values[cell.obligation] = value = cell.settle(now)
                now.before = _compose(now, cell.depends)
            else:
                now.before = _compose(now, cell.depends)
                value = cell.settle(now)
            longer = value[None] if now.before is None else _append(now.before, value)
            now.tables[cell.index] = longer
            kept.append(_table_rows_first(longer[-cell.keep :], now.n) if cell.keep else None)
        return tuple(kept)


@functools.lru_cache(maxsize=256)
def follower(node: f.Node, closed: bool) -> Follower:
    """The engine of a formula, kept for the next monitor of the same formula."""
    return Follower(node, closed)


def _compose(now: Moment, depends: frozenset[int]) -> Array | None:
    if now.before is None or not depends:
        return now.before
    return compose(now.before, now.values, 1)


def _append(table: Array, value: Array) -> Array:
    """A table with one more row."""
    longer = np.empty((len(table) + 1, *value.shape))
    longer[:-1], longer[-1] = table, value
    return longer


def _time_first(table: Array, n: int) -> Array:
    """(N, K, corners, ...) as (K, corners, N, ...)."""
    return np.moveaxis(table, 0, n + 1) if n else table.swapaxes(0, 1)


def _table_rows_first(table: Array, n: int) -> Array:
    return np.moveaxis(table, n + 1, 0) if n else table.swapaxes(0, 1)


def _rows_first(carried: tuple[Array, ...] | None, n: int) -> tuple[Array, ...] | None:
    """(corners, N, ...) as (N, corners, ...)."""
    return tuple(np.moveaxis(x, n, 0) for x in carried) if carried else carried


def _corners_first(carried: tuple[Array, ...] | None, n: int) -> tuple[Array, ...] | None:
    return tuple(np.moveaxis(x, 0, n) for x in carried) if carried else carried


class FormulaMonitor:
    """Follows a formula at sample 0 (an ``avrare.protocols.Specification``).

    A step costs the same at every sample; ``avrare.logic.plan`` names the few formulas whose history is kept
    and evaluated. NaN makes a row's robustness NaN for good where the formula depends on it; such a row is
    neither violated nor does its score change.

    Args:
        formula: From ``avrare.stl``.
    """

    def __init__(self, formula: Formula) -> None:
        self.formula = formula
        self._follower = follower(formula.node, formula.closed)
        self._names = formula.signals

    def __reduce__(self) -> tuple[object, ...]:
        return type(self), (self.formula,)

    def start(self, n: int) -> MonitorState:
        """Monitor state of ``n`` particles before sample 0."""
        newest = np.full(n, math.inf) if self._follower.plan.body else None
        robustness, violated = np.full(n, math.inf), np.zeros(n, dtype=np.bool_)
        return MonitorState(0, self._follower.start(), robustness, violated, np.full(n, -math.inf), newest)

    def margin(self, state: MonitorState) -> Floats | None:
        """For ``always φ``, φ looking only back: the robustness (N,) of φ at the newest sample; else None.

        It is infinite before sample 0. Unlike the running minimum it tells apart particles that have been
        equally near to failure.
        """
        return state.newest

    def update(self, state: MonitorState, signals: Signals) -> tuple[MonitorState, Verdict]:
        """Monitor state and verdict after one more sample.

        Args:
            state: Not changed.
            signals: name -> (N,), or (N, V) below a quantifier.

        Raises:
            FormulaError: A signal is missing or has the wrong shape.
        """
        sample = read_sample(signals, self._names, len(state.score))
        with np.errstate(all="ignore"):
            new = self.follow(state, sample)
        return new, Verdict(new.robustness, new.violated, new.score)

    def follow(self, state: MonitorState, sample: Mapping[str, Array]) -> MonitorState:
        """The state after one more sample, already read."""
        t, plan = state.t, self._follower.plan
        if t > plan.horizon:
            kept = (state.robustness, state.violated, state.score, state.newest)
            return MonitorState(t + 1, (), *kept)
        carried, seen = self._follower.advance(state.carried, sample, t, len(state.score))
        values = [self._follower.value(now, leaves) for now, leaves in seen]
        robustness = flush(values[0])
        newest = None
        if plan.body:
            now, _ = seen[0]
            newest = flush(now.at(plan.body, 0))
        violated = values[-1] < 0.0
        if len(values) > 1:
            violated &= ~np.isnan(robustness)
        score = np.fmax(state.score, -robustness)
        return MonitorState(t + 1, carried, robustness, violated, score, newest)
