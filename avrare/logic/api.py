"""``avrare.stl(...)``: a formula as users hold it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from avrare.errors import FormulaError
from avrare.logic import formula as f
from avrare.logic.algebra import Bounds, Robustness, Truth
from avrare.logic.online import FormulaMonitor
from avrare.logic.parse import parse
from avrare.logic.plan import make_plan, prefix_values
from avrare.logic.printing import text as to_text
from avrare.logic.robustness import Evaluator
from avrare.logic.samples import Trace, read_trace

Signals = Mapping[str, NDArray[Any]]
Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]


def stl(text: str, dt: float | Fraction = 1.0, until: str = "closed") -> Formula:
    """Read a formula of signal temporal logic.

    Args:
        text: The formula, in rtamt's syntax or close to it: ``always[0:3s] (p > 0.2)``.
        dt: Sampling period [s]; bounds must be whole multiples of it.
        until: ``"closed"``: until and since need their left operand at the witness too (Donze and Maler,
            stl-ams, stl-ess); ``"half-open"``: they do not (rtamt).

    Raises:
        FormulaError: The text is not a formula, or ``dt`` or ``until`` makes no sense.
    """
    if until not in ("closed", "half-open"):
        raise FormulaError(f"until is {until!r}", 'use until="closed" or until="half-open"')
    return Formula(text, dt, until, parse(text, dt))


@dataclass(frozen=True)
class Formula:
    """A formula and how to read it. ``str()`` gives it with its bounds in samples.

    Signals map names to arrays (N, T), or (T,) for one trace, or (N, T, V) below a quantifier; results have
    the same leading axes. Names that the formula does not use are ignored. All methods raise ``FormulaError``
    when a signal is missing, has the wrong shape or holds NaN.

    Attributes:
        text: What the user wrote.
        dt: Sampling period [s].
        until: ``"closed"`` or ``"half-open"``.
        node: The formula as a tree.
    """

    text: str
    dt: float | Fraction
    until: str
    node: f.Node

    def __str__(self) -> str:
        return to_text(self.node)

    @property
    def signals(self) -> tuple[str, ...]:
        """The names of the signals that the formula reads."""
        return f.signals(self.node)

    @property
    def horizon(self) -> float:
        """Samples that it looks ahead: nested future bounds added up; ``math.inf`` if unbounded."""
        return f.horizon(self.node)

    @property
    def history(self) -> float:
        """Samples that it looks back: nested past bounds added up; ``math.inf`` if unbounded."""
        return f.history(self.node)

    @property
    def closed(self) -> bool:
        """Whether until and since need their left operand at the witness."""
        return self.until == "closed"

    def robustness(self, signals: Signals) -> Floats:
        """Robustness at every sample, with windows clipped to the trace: (N, T)."""
        trace = read_trace(signals, self.signals)
        return _result(self._evaluator(trace, Robustness())(self.node), trace)

    def satisfied(self, signals: Signals) -> Bools:
        """Exact truth at every sample: (N, T); ``x < 4`` is false at 4, where its robustness is 0."""
        trace = read_trace(signals, self.signals)
        _result(self._evaluator(trace, Robustness())(self.node), trace)  # raises where a term is NaN
        return _result(self._evaluator(trace, Truth())(self.node), trace)

    def prefixes(self, signals: Signals) -> Floats:
        """Robustness at sample 0 of samples 0..t, for every t: (N, T) (nominal, stl-ams eq. 14)."""
        trace = read_trace(signals, self.signals)
        plan = make_plan(self.node, memories=False)
        return _result(prefix_values(plan, self._evaluator(trace, Robustness())), trace)

    def intervals(self, signals: Signals, length: int | None = None) -> Floats:
        """Bounds of the robustness at sample 0 after each sample, whatever comes next: (N, T, 2).

        Lower bounds never fall, upper bounds never rise.

        Args:
            signals: The samples so far.
            length: Samples of the whole trace; samples from there on do not exist and the bounds meet at the
                last one. None: the trace goes on for ever.
        """
        trace = read_trace(signals, self.signals)
        if length is not None and length < trace.steps:
            raise FormulaError(f"length is {length} but the signals have {trace.steps} samples")
        seen = int(min(trace.steps, self.horizon + 1))
        bounds = [self._interval(trace, t + 1, length) for t in range(seen)]
        bounds += bounds[-1:] * (trace.steps - seen)
        return _finish(np.stack(bounds), trace)

    def monitor(self) -> FormulaMonitor:
        """A monitor that follows the formula one sample at a time."""
        return FormulaMonitor(self)

    def _interval(self, trace: Trace, seen: int, length: int | None) -> Floats:
        grid = length or seen + f.settling(self.node) + 1
        evaluate = self._evaluator(trace, Bounds(grid, endless=length is None)).last(seen, seen)
        values = evaluate(self.node)
        _require_scalar(values.ndim - 3)
        return np.moveaxis(values[0], 0, -1)

    def _evaluator(self, trace: Trace, algebra: Robustness) -> Evaluator:
        return Evaluator(trace.samples, trace.steps, trace.rows, algebra, self.closed)


def _result(values: NDArray[Any], trace: Trace) -> NDArray[Any]:
    _require_scalar(values.ndim - 2)
    return _finish(values, trace)


def _finish(values: NDArray[Any], trace: Trace) -> NDArray[Any]:
    """Rows first, as the user gave them."""
    if values.dtype != np.bool_ and np.isnan(values).any():
        raise FormulaError(
            "a term of the formula has no value (NaN) for these signals",
            "look for the difference of two infinite signals, log or sqrt of a negative number, or 0/0",
        )
    rows_first = np.ascontiguousarray(np.moveaxis(values, 0, 1))
    return rows_first[0] if trace.single else rows_first


def _require_scalar(trailing: int) -> None:
    if trailing > 0:
        raise FormulaError(
            f"the formula has {trailing} trailing {'axes' if trailing > 1 else 'axis'} left at every sample",
            "put 'forall o in others:' or 'exists o in others:' before the part with array-valued signals",
        )
