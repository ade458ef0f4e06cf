"""Monitors of a formula's robustness, and of its robust satisfaction interval, one sample at a time."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from avrare.base.errors import FormulaError
from avrare.logic.monitor.monitor_plan import Carry, MonitorPlan
from avrare.logic.semantics.input_signals import read_sample
from avrare.logic.semantics.value_algebra import flush
from avrare.logic.syntax import nodes
from avrare.protocols import Bools, Floats, Signals, Verdict

_ZERO = np.zeros(())
"""NumPy compares faster with an array than with a number."""

_get_plan = lru_cache(maxsize=256)(MonitorPlan)


class MonitorState(NamedTuple):
    """State of a robustness monitor: a value that is copied with its particle.

    Attributes:
        t: Samples seen; the same for all particles of a batch.
        carried: Carry of the margins, and of the truth if the signs of the margins do not tell it.
        verdict: Verdict on the samples so far; its score is the running maximum of minus the robustness.
        newest: (N,) values of φ at the newest sample in each algebra, for ``always φ``; else empty.
    """

    t: int
    carried: tuple[Carry, ...]
    verdict: Verdict
    newest: tuple[Floats, ...]


class _Monitor:
    def __init__(self, node: nodes.Node, closed: bool, plain: bool = False) -> None:
        self._node, self._closed = node, closed
        self._plan = _get_plan(node, closed, plain)
        self._names = nodes.signals(node)

    def __reduce__(self) -> tuple[object, ...]:
        return type(self), (self._node, self._closed)


class RobustnessMonitor(_Monitor):
    """Monitor of a formula's robustness at sample 0 (an ``avrare.protocols.Specification``).

    Every step costs the same, except for the few formulas that ``plan`` names, whose history is carried and
    evaluated. NaN makes a row's robustness NaN for good if the formula depends on it; that row is neither
    violated nor does its score change.

    Args:
        node: Formula.
        closed: True if until and since need their left operand at the witness.
    """

    def __init__(self, node: nodes.Node, closed: bool) -> None:
        super().__init__(node, closed, plain=True)

    def start(self, n: int) -> MonitorState:
        """Return the state of ``n`` particles before sample 0."""
        newest = (np.full(n, math.inf),) * len(self._plan.algebras) if self._plan.body else ()
        verdict = Verdict(np.full(n, math.inf), np.zeros(n, dtype=np.bool_), np.full(n, -math.inf))
        return MonitorState(0, self._plan.start(), verdict, newest)

    def margin(self, state: MonitorState) -> Floats | None:
        """Return the robustness (N,) of φ at the newest sample, for ``always φ`` with φ not looking ahead.

        It is infinite before sample 0, and None for other formulas. Unlike the running minimum it
        distinguishes particles that have been equally near to failure.
        """
        return flush(state.newest[0]) if state.newest else None

    def holds(self, state: MonitorState) -> Bools:
        """Return where φ is true (N,) at the newest sample, for ``always φ`` as in ``margin``."""
        return np.asarray(~self._plan.is_false(state.newest[-1], _ZERO))

    def update(self, state: MonitorState, signals: Signals) -> tuple[MonitorState, Verdict]:
        """Return state and verdict after one more sample.

        Args:
            state: State before the sample; not changed.
            signals: name -> (N,), or (N, V) below a quantifier.

        Raises:
            FormulaError: A signal is missing or has the wrong shape.
        """
        t, before, plan, rows = state.t, state.verdict, self._plan, len(state.verdict.score)
        sample = read_sample(signals, self._names, rows)
        if t > plan.horizon:
            return MonitorState(t + 1, (), before, state.newest), before
        with np.errstate(all="ignore"):
            carried, values, newest = plan.advance(state.carried, sample, t, rows)
            robustness, violated = flush(values[0]), plan.is_false(values[-1], _ZERO)
            falling = plan.falling and robustness is values[0]  # only then there is no NaN
            score = -robustness if falling else np.fmax(before.score, -robustness)
        verdict = Verdict(robustness, violated, score)
        return MonitorState(t + 1, carried, verdict, newest), verdict


@dataclass(frozen=True)
class IntervalVerdict:
    """Possible outcomes of the formula at sample 0 over all continuations.

    Attributes:
        lower: (N,) least robustness; never falls.
        upper: (N,) greatest robustness; never rises.
        decided: (N,) True where the truth is final.
        violated: (N,) True where it is final and false.
    """

    lower: Floats
    upper: Floats
    decided: Bools
    violated: Bools


@dataclass(frozen=True)
class IntervalState:
    """State of an interval monitor: a value that is copied with its particle.

    Attributes:
        t: Samples seen; the same for all particles of a batch.
        carried: Carry, as in ``MonitorState``.
        verdict: Verdict after the last sample; before the first everything is possible.
    """

    t: int
    carried: tuple[Carry, ...]
    verdict: IntervalVerdict


class IntervalMonitor(_Monitor):
    """Monitor of bounds of a formula's robustness at sample 0 over all continuations.

    The bounds come from interval arithmetic: they hold for every continuation, and are exact unless a sample
    is used more than once, as it is under ``rise`` and ``fall``. Every step costs the same, as with
    ``RobustnessMonitor``. A row whose value is NaN is never decided.

    Args:
        node: Formula.
        closed: True if until and since need their left operand at the witness.
        length: Samples of the complete trace, at the last of which the bounds meet; None: endless.

    Raises:
        FormulaError: ``length`` is below 1.
    """

    def __init__(self, node: nodes.Node, closed: bool, length: int | None = None) -> None:
        if length is not None and length < 1:
            raise FormulaError(f"length must be at least 1, not {length}", "leave it out where it is unknown")
        super().__init__(node, closed)
        self.length = length

    def __reduce__(self) -> tuple[object, ...]:
        return type(self), (self._node, self._closed, self.length)

    def start(self, n: int) -> IntervalState:
        """Return the state of ``n`` particles before sample 0."""
        undecided = np.zeros(n, dtype=np.bool_)
        nothing = IntervalVerdict(np.full(n, -math.inf), np.full(n, math.inf), undecided, undecided)
        return IntervalState(0, self._plan.start(), nothing)

    def update(self, state: IntervalState, signals: Signals) -> tuple[IntervalState, IntervalVerdict]:
        """Return state and verdict after one more sample.

        Args:
            state: State before the sample; not changed.
            signals: name -> (N,), or (N, V) below a quantifier.

        Raises:
            FormulaError: A signal is missing or has the wrong shape, or the trace is longer than its length.
        """
        if self.length is not None and state.t >= self.length:
            raise FormulaError(f"length is {self.length} but there are more samples")
        t, plan, rows = state.t, self._plan, len(state.verdict.lower)
        sample = read_sample(signals, self._names, rows)
        if t > plan.horizon:
            return IntervalState(t + 1, (), state.verdict), state.verdict
        unseen = plan.lay_out_rest(t + 1, self.length)
        with np.errstate(all="ignore"):
            carried, values, _ = plan.advance(state.carried, sample, t, rows, unseen)
        (lower, upper), truth = flush(values[0]), values[-1]
        violated = truth[1] < 0.0
        verdict = IntervalVerdict(lower, upper, violated | (truth[0] > 0.0), violated)
        return IntervalState(t + 1, carried, verdict), verdict
