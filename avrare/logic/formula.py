"""Formula: the public value made by ``avrare.stl(...)``, and the monitor that remembers it."""

from __future__ import annotations

import functools
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any

import numpy as np

from avrare.base.errors import FormulaError
from avrare.logic.explanation import Explanation, FormulaValues, to_single_trace
from avrare.logic.monitor.monitors import IntervalMonitor, RobustnessMonitor
from avrare.logic.semantics.input_signals import Trace, read_trace
from avrare.logic.semantics.normal_form import normalise
from avrare.logic.semantics.trace_evaluator import Evaluator, require_scalar
from avrare.logic.semantics.value_algebra import RobustnessAlgebra, SignedAlgebra, flush
from avrare.logic.syntax import nodes
from avrare.logic.syntax.lint import LintWarning, choose_warnings
from avrare.logic.syntax.parser import parse, parse_with_warnings
from avrare.logic.syntax.printer import to_text
from avrare.protocols import Bools, Floats, Signals, Specification


class FormulaWarning(UserWarning):
    """Warning that a formula may not mean what its author intends."""


def stl(
    text: str, dt: float | Fraction | None = None, until: str = "closed", *, warn: bool = True
) -> Formula:
    """Parse a formula of signal temporal logic.

    Args:
        text: Formula, in rtamt's syntax or close to it: ``always[0:3s] (p > 0.2)``.
        dt: Sampling period [s]; bounds must be whole multiples of it. None: the step of the system that a
            problem pairs the formula with, 1 s where there is none.
        until: ``"closed"``: until and since need their left operand at the witness too (Donze and Maler,
            stl-ams, stl-ess); ``"half-open"``: they do not (rtamt).
        warn: True to issue lint warnings as ``FormulaWarning``; ``Formula.warnings`` has them anyway.

    Raises:
        FormulaError: The text is not a formula, or ``dt`` or ``until`` is invalid.
    """
    if until not in ("closed", "half-open"):
        raise FormulaError(f"until is {until!r}", 'use until="closed" or until="half-open"')
    # without a step, bounds are multiples of 1 ns
    lint = choose_warnings(parse_with_warnings(text, Fraction(1, 10**9) if dt is None else dt)[1], until)
    if warn:
        for warning in lint:
            hint = f"\nhint: {warning.hint}" if warning.hint else ""
            warnings.warn(FormulaWarning(warning.message + hint), stacklevel=2)
    return Formula(text, dt, until, lint)


@dataclass(frozen=True)
class Formula:
    """Formula with its sampling period and its reading of until. ``str()`` gives it with bounds in samples.

    Signals map names to arrays (N, T), or (T,) for one trace, or (N, T, V) below a quantifier; results have
    the same leading axes. Names that the formula does not use are ignored. All methods raise ``FormulaError``
    if a signal is missing, has the wrong shape or holds NaN.

    Attributes:
        text: Text as the user wrote it.
        dt: Sampling period [s]; None: 1 s, until ``at`` gives it that of a system.
        until: ``"closed"`` or ``"half-open"``.
        warnings: Lint warnings about the text.
        derived: Syntax tree of a formula that was derived from the text's; None: that of the text.
    """

    text: str
    dt: float | Fraction | None
    until: str
    warnings: tuple[LintWarning, ...] = ()
    derived: nodes.Node | None = None

    @property
    def period(self) -> float | Fraction:
        """Time of a sample [s]: ``dt``, or 1 s."""
        return 1.0 if self.dt is None else self.dt

    @functools.cached_property
    def node(self) -> nodes.Node:
        """Syntax tree, with bounds in samples."""
        return parse(self.text, self.period) if self.derived is None else self.derived

    def at(self, dt: float) -> Formula:
        """Return the formula with the step of a system [s].

        Raises:
            FormulaError: A bound is not a multiple of the step, or the formula has another sampling period.
        """
        if self.dt is None and self.derived is None:
            return stl(self.text, dt, self.until, warn=False)
        try:
            fits = parse(self.text, dt) == parse(self.text, self.period)
        except FormulaError:  # a bound is no multiple of the step
            fits = False
        if not fits:
            period = float(self.period)
            text = f"{self.text!r} takes {period:g} s for a sample, but a step of the system is {dt:g} s"
            hint = f"leave dt out, or give the formula the step: avrare.stl(..., dt={dt:g})"
            raise FormulaError(text, hint)
        return replace(self, dt=dt) if self.dt is None else self

    def __str__(self) -> str:
        return to_text(self.node)

    @functools.cached_property
    def signals(self) -> tuple[str, ...]:
        """Names of the signals that the formula reads."""
        return nodes.signals(self.node)

    @property
    def horizon(self) -> float:
        """Samples that the formula looks ahead: nested future bounds added up; ``math.inf`` if unbounded."""
        return nodes.horizon(self.node)

    @property
    def history(self) -> float:
        """Samples that the formula looks back: nested past bounds added up; ``math.inf`` if unbounded."""
        return nodes.history(self.node)

    @property
    def closed(self) -> bool:
        """Reading of until and since: True if they need their left operand at the witness."""
        return self.until == "closed"

    def robustness(self, signals: Signals) -> Floats:
        """Return the robustness at every sample, with windows clipped to the trace: (N, T)."""
        return self._evaluate(signals, RobustnessAlgebra())

    def satisfied(self, signals: Signals) -> Bools:
        """Return the exact truth at every sample: (N, T); ``x < 4`` is false at 4, where robustness is 0."""
        return self._evaluate(signals, SignedAlgebra()) > 0.0

    def prefixes(self, signals: Signals) -> Floats:
        """Return the robustness at sample 0 of samples 0..t, for every t: (N, T) (stl-ams, Eq. 14)."""
        verdicts = _follow(self.monitor(), trace := read_trace(signals, self.signals))
        return _finish(np.stack([verdict.robustness for verdict in verdicts], axis=1), trace)

    def intervals(self, signals: Signals, length: int | None = None) -> Floats:
        """Return bounds of the robustness at sample 0 after each sample, over all continuations: (N, T, 2).

        Lower bounds never fall, upper bounds never rise.

        Args:
            signals: Samples so far.
            length: Samples of the complete trace, at the last of which the bounds meet. None: the trace is
                endless.
        """
        trace = read_trace(signals, self.signals)
        if length is not None and length < trace.steps:
            raise FormulaError(f"length is {length} but the signals have {trace.steps} samples")
        verdicts = _follow(self.interval_monitor(length), trace)
        bounds = [np.stack([verdict.lower, verdict.upper], axis=1) for verdict in verdicts]
        return _finish(np.stack(bounds, axis=1), trace)

    def parts(self, signals: Signals) -> dict[str, Floats]:
        """Return the robustness of every distinct sub-formula by its text, the whole formula first.

        Values are (N, T), below a quantifier (N, T, V...) with one axis per enclosing quantifier.
        """
        trace = read_trace(signals, self.signals)
        values = self._evaluate_parts(trace, RobustnessAlgebra())
        source_nodes = [node for node in nodes.walk(self.node) if isinstance(node, nodes.Node)]
        return {
            to_text(node): _finish(flush(np.moveaxis(values[node], 0, 1)), trace) for node in source_nodes
        }

    def explain(self, signals: Signals, members: Mapping[str, Sequence[str]] | None = None) -> Explanation:
        """Explain the formula's value at sample 0 of one trace.

        Args:
            signals: (T,) each, relations (T, V...); or the same with a leading axis of length 1.
            members: group -> names of its vehicles, for bindings and text.
        """
        trace = read_trace(to_single_trace(signals, self.node), self.signals)
        margins = self._evaluate_parts(trace, RobustnessAlgebra())
        truths = self._evaluate_parts(trace, SignedAlgebra())
        return FormulaValues(margins, truths, members or {}, self.closed).explain(self.node)

    def monitor(self) -> FormulaMonitor:
        """Return a monitor that follows the formula one sample at a time."""
        return FormulaMonitor(self)

    def interval_monitor(self, length: int | None = None) -> IntervalMonitor:
        """Return a monitor of the robust satisfaction interval; see ``IntervalMonitor``."""
        return IntervalMonitor(self.node, self.closed, length)

    @functools.cached_property
    def _normal_form(self) -> nodes.Node:
        return normalise(self.node)

    def _evaluate(self, signals: Signals, algebra: RobustnessAlgebra) -> Floats:
        trace = read_trace(signals, self.signals)
        values = np.empty((trace.rows, trace.steps))
        for rows in trace.blocks():
            block = trace.take(rows)
            x = Evaluator(block.samples, block.steps, block.rows, algebra, self.closed)(self._normal_form)
            require_scalar(x.ndim - 2)
            flushed = flush(x)
            if flushed is not x:  # else there is no NaN
                _reject_nan(x)
            values[rows] = (x if isinstance(algebra, SignedAlgebra) else flushed).T
        return values[0] if trace.single else values

    def _evaluate_parts(self, trace: Trace, algebra: RobustnessAlgebra) -> dict[nodes.Node, Floats]:
        values: dict[nodes.Node, Floats] = {}
        evaluate = Evaluator(trace.samples, trace.steps, trace.rows, algebra, self.closed, values=values)
        require_scalar(evaluate(self.node).ndim - 2)
        return values


class FormulaMonitor(RobustnessMonitor, Specification):
    """Robustness monitor that remembers its formula, for explanations and early stopping.

    Args:
        formula: Formula from ``avrare.stl``.
    """

    def __init__(self, formula: Formula) -> None:
        super().__init__(formula.node, formula.closed)
        self.formula = formula

    def __reduce__(self) -> tuple[object, ...]:
        return type(self), (self.formula,)


def _follow(monitor: Any, trace: Trace) -> Iterator[Any]:
    state = monitor.start(trace.rows)
    for t in range(trace.steps):
        state, verdict = monitor.update(state, trace.at(t))
        yield verdict


def _finish(values: Floats, trace: Trace) -> Floats:
    _reject_nan(values)
    return values[0] if trace.single else values


def _reject_nan(values: Floats) -> None:
    if np.isnan(values).any():
        raise FormulaError(
            "a term of the formula has no value (NaN) for these signals",
            "look for the difference of two infinite signals, log or sqrt of a negative number, or 0/0",
        )
