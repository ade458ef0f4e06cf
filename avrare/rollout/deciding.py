"""Specifications that tell when their verdict is final, so that a rollout may end there."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from avrare.logic.intervals import IntervalMonitor
from avrare.protocols import Bools, Signals, Specification, Verdict


@dataclass(frozen=True)
class DecidingState:
    """State of a monitor and of the bounds beside it.

    Attributes:
        inner: State of the specification.
        bounds: State of the interval monitor; None where there is no formula to bound.
        decided: (N,) nothing that may follow changes the verdict.
    """

    inner: Any
    bounds: Any
    decided: Bools


class Deciding:
    """A specification beside the robust satisfaction interval of its formula.

    Args:
        inner: A formula's monitor, or a specification with a ``formula`` and the ``sample(signals)`` that it
            reads. Any other is never decided before the end.
        length: Samples of a whole run.
    """

    def __init__(self, inner: Specification, length: int) -> None:
        self.inner = inner
        formula = getattr(inner, "formula", None)
        self._bounds = IntervalMonitor(formula, length) if formula is not None else None
        self._read: Any = getattr(inner, "sample", None) or (lambda signals: signals)

    def start(self, n: int) -> DecidingState:
        """Before sample 0."""
        bounds = self._bounds.start(n) if self._bounds else None
        return DecidingState(self.inner.start(n), bounds, np.zeros(n, dtype=bool))

    def update(self, state: DecidingState, signals: Signals) -> tuple[DecidingState, Verdict]:
        """After one more sample; the verdict of decided rows is that of the whole run."""
        inner, verdict = self.inner.update(state.inner, signals)
        if self._bounds is None:
            return replace(state, inner=inner), verdict
        bounds, known = self._bounds.update(state.bounds, self._read(signals))
        final = np.where(known.decided, known.violated, verdict.violated)
        within = np.clip(verdict.robustness, known.lower, known.upper)
        robustness = np.where(known.decided, within, verdict.robustness)
        new = DecidingState(inner, bounds, known.decided)
        return new, replace(verdict, violated=final, robustness=robustness)
