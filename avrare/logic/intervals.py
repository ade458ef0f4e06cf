"""Robust satisfaction intervals, one sample at a time: what the samples so far leave open."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from avrare.errors import FormulaError
from avrare.logic.algebra import flush
from avrare.logic.online import Carried, follower
from avrare.logic.samples import read_sample
from avrare.protocols import Bools, Floats, Signals

if TYPE_CHECKING:
    from avrare.logic.api import Formula


@dataclass(frozen=True)
class IntervalVerdict:
    """What can still become of the formula at sample 0, whatever the samples to come.

    Attributes:
        lower: (N,) least robustness; never falls.
        upper: (N,) greatest robustness; never rises.
        decided: (N,) the Boolean truth can change no more.
        violated: (N,) decided, and false.
    """

    lower: Floats
    upper: Floats
    decided: Bools
    violated: Bools


@dataclass(frozen=True)
class IntervalState:
    """An interval monitor's state: a value that is copied with its particle.

    Attributes:
        t: Samples seen; the same for all particles of a batch.
        carried: As in ``MonitorState``.
        verdict: After the last sample; everything is possible before the first.
    """

    t: int
    carried: tuple[Carried, ...]
    verdict: IntervalVerdict


class IntervalMonitor:
    """Bounds the robustness of a formula at sample 0 over everything that may follow.

    The bounds come from interval arithmetic: they hold for every continuation, and are exact unless a sample
    is used more than once, as it is under ``rise`` and ``fall``. A step costs the same at every sample, as
    with ``FormulaMonitor``. A row whose value is NaN is never decided.

    Args:
        formula: From ``avrare.stl``.
        length: Samples of the whole trace, at the last of which the bounds meet; None: it goes on for ever.

    Raises:
        FormulaError: ``length`` is below 1.
    """

    def __init__(self, formula: Formula, length: int | None = None) -> None:
        if length is not None and length < 1:
            raise FormulaError(f"length is {length}", "a trace has at least one sample")
        self.formula = formula
        self.length = length
        self._follower = follower(formula.node, formula.closed)
        self._names = formula.signals

    def __reduce__(self) -> tuple[object, ...]:
        return type(self), (self.formula, self.length)

    def start(self, n: int) -> IntervalState:
        """Monitor state of ``n`` particles before sample 0."""
        undecided = np.zeros(n, dtype=np.bool_)
        nothing = IntervalVerdict(np.full(n, -math.inf), np.full(n, math.inf), undecided, undecided)
        return IntervalState(0, self._follower.start(), nothing)

    def update(self, state: IntervalState, signals: Signals) -> tuple[IntervalState, IntervalVerdict]:
        """Monitor state and verdict after one more sample.

        Args:
            state: Not changed.
            signals: name -> (N,), or (N, V) below a quantifier.

        Raises:
            FormulaError: A signal is missing or has the wrong shape, or the trace is longer than its length.
        """
        if self.length is not None and state.t >= self.length:
            raise FormulaError(f"length is {self.length} but there are more samples")
        sample = read_sample(signals, self._names, len(state.verdict.lower))
        with np.errstate(all="ignore"):
            new = self.follow(state, sample)
        return new, new.verdict

    def follow(self, state: IntervalState, sample: Mapping[str, NDArray[Any]]) -> IntervalState:
        """The state after one more sample, already read."""
        t, engine = state.t, self._follower
        if t > engine.plan.horizon:
            return IntervalState(t + 1, (), state.verdict)
        carried, seen = engine.advance(state.carried, sample, t, len(state.verdict.lower))
        tail = engine.tail(t + 1, self.length)
        values = [engine.value(now, leaves, tail) for now, leaves in seen]
        lower, upper = flush(values[0])
        truth = values[-1]
        violated = truth[1] < 0.0
        decided = violated | (truth[0] > 0.0)
        if len(values) > 1:
            known = ~np.isnan(lower)
            violated, decided = violated & known, decided & known
        return IntervalState(t + 1, carried, IntervalVerdict(lower, upper, decided, violated))
