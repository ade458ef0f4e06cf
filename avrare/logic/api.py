"""``avrare.stl(...)``: a formula as users hold it."""

from __future__ import annotations

import functools
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from avrare.errors import FormulaError
from avrare.logic import formula as f
from avrare.logic.algebra import Robustness, Signed, Truth, flush
from avrare.logic.causes import Values
from avrare.logic.complaints import Complaint
from avrare.logic.explain import Explanation, explain, one_trace
from avrare.logic.intervals import IntervalMonitor
from avrare.logic.normal import core
from avrare.logic.online import FormulaMonitor
from avrare.logic.parse import parse_with_warnings
from avrare.logic.printing import text as to_text
from avrare.logic.robustness import Evaluator, require_scalar
from avrare.logic.samples import Trace, read_trace

Signals = Mapping[str, NDArray[Any]]
Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]


class FormulaWarning(UserWarning):
    """A formula that may not mean what its writer means."""


def stl(text: str, dt: float | Fraction = 1.0, until: str = "closed", *, warn: bool = True) -> Formula:
    """Read a formula of signal temporal logic.

    Args:
        text: The formula, in rtamt's syntax or close to it: ``always[0:3s] (p > 0.2)``.
        dt: Sampling period [s]; bounds must be whole multiples of it.
        until: ``"closed"``: until and since need their left operand at the witness too (Donze and Maler,
            stl-ams, stl-ess); ``"half-open"``: they do not (rtamt).
        warn: Whether to issue what looks odd as ``FormulaWarning``; ``Formula.warnings`` has it anyway.

    Raises:
        FormulaError: The text is not a formula, or ``dt`` or ``until`` makes no sense.
    """
    if until not in ("closed", "half-open"):
        raise FormulaError(f"until is {until!r}", 'use until="closed" or until="half-open"')
    node, complaints = parse_with_warnings(text, dt)
    if warn:
        for complaint in complaints:
            hint = f"\nhint: {complaint.hint}" if complaint.hint else ""
            warnings.warn(FormulaWarning(complaint.message + hint), stacklevel=2)
    return Formula(text, dt, until, node, complaints)


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
        warnings: What looks odd in the text.
    """

    text: str
    dt: float | Fraction
    until: str
    node: f.Node
    warnings: tuple[Complaint, ...] = ()

    def __str__(self) -> str:
        return to_text(self.node)

    @functools.cached_property
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
        return self._evaluate(trace, Robustness())

    def satisfied(self, signals: Signals) -> Bools:
        """Exact truth at every sample: (N, T); ``x < 4`` is false at 4, where its robustness is 0."""
        trace = read_trace(signals, self.signals)
        if self._apart:
            self._evaluate(trace, Robustness())  # raises where a term is NaN
        return self._evaluate(trace, Truth() if self._apart else Signed()) > 0.0

    def prefixes(self, signals: Signals) -> Floats:
        """Robustness at sample 0 of samples 0..t, for every t: (N, T) (nominal, stl-ams eq. 14)."""
        trace = read_trace(signals, self.signals)
        monitor, values = self.monitor(), np.empty((trace.rows, trace.steps))
        state = monitor.start(trace.rows)
        with np.errstate(all="ignore"):
            for t in range(trace.steps):
                state = monitor.follow(state, trace.at(t))
                values[:, t] = state.robustness
        return _finish(values, trace)

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
        monitor, bounds = IntervalMonitor(self, length), np.empty((trace.rows, trace.steps, 2))
        state = monitor.start(trace.rows)
        with np.errstate(all="ignore"):
            for t in range(trace.steps):
                state = monitor.follow(state, trace.at(t))
                bounds[:, t, 0], bounds[:, t, 1] = state.verdict.lower, state.verdict.upper
        return _finish(bounds, trace)

    def parts(self, signals: Signals) -> dict[str, Floats]:
        """Robustness of every distinct sub-formula by its text, the whole formula first.

        Values are (N, T), below a quantifier (N, T, V...) with one axis per quantifier around.
        """
        trace = read_trace(signals, self.signals)
        found = self._found(trace, Robustness())
        written = [node for node in f.walk(self.node) if isinstance(node, f.Node)]
        return {to_text(node): _finish(flush(np.moveaxis(found[node], 0, 1)), trace) for node in written}

    def explain(self, signals: Signals, members: Mapping[str, Sequence[str]] | None = None) -> Explanation:
        """What decides the formula at sample 0 of one trace.

        Args:
            signals: (T,) each, relations (T, V...); or the same with a leading axis of length 1.
            members: group -> the names of its vehicles, for bindings and text.
        """
        trace = read_trace(one_trace(signals, self.node), self.signals)
        margins = self._found(trace, Robustness())
        truths = self._found(trace, Truth() if self._apart else Signed())
        return explain(self.node, Values(margins, truths, members or {}, self.closed))

    def monitor(self) -> FormulaMonitor:
        """A monitor that follows the formula one sample at a time."""
        return FormulaMonitor(self)

    @functools.cached_property
    def _core(self) -> f.Node:
        """The formula in few operators: less to compute."""
        return core(self.node)

    @functools.cached_property
    def _apart(self) -> bool:
        """Whether the sign of the margins does not tell the truth."""
        return any(isinstance(x, f.Connective) and x.op in ("iff", "xor") for x in f.walk(self.node))

    def _evaluate(self, trace: Trace, algebra: Robustness) -> Floats:
        """The formula's values as the user gave the signals, computed in blocks of rows."""
        values = np.empty((trace.rows, trace.steps))
        for rows in trace.blocks():
            block = trace.take(rows)
            x = Evaluator(block.samples, block.steps, block.rows, algebra, self.closed)(self._core)
            require_scalar(x.ndim - 2)
            shown = flush(x)
            if shown is not x:
                _reject_nan(x)
            values[rows] = (x if isinstance(algebra, Signed) else shown).T
        return values[0] if trace.single else values

    def _found(self, trace: Trace, algebra: Robustness) -> dict[f.Node, Floats]:
        """The values (T, N, ...) of all sub-formulas."""
        found: dict[f.Node, Floats] = {}
        require_scalar(
            Evaluator(trace.samples, trace.steps, trace.rows, algebra, self.closed, found=found)(
                self.node
            ).ndim
            - 2
        )
        return found


def _finish(values: NDArray[Any], trace: Trace) -> NDArray[Any]:
    """Values (N, T, ...) as the user gave the signals.

    Raises:
        FormulaError: There are NaN among them.
    """
    _reject_nan(values)
    return values[0] if trace.single else values


def _reject_nan(values: Floats) -> None:
    if np.isnan(values).any():
        raise FormulaError(
            "a term of the formula has no value (NaN) for these signals",
            "look for the difference of two infinite signals, log or sqrt of a negative number, or 0/0",
        )
