"""Early stop: specifications that report when their verdict is final, so that a rollout may end there."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from avrare.protocols import Bools, Floats, Signals, Specification, Verdict


@dataclass(frozen=True)
class DecidingState:
    """State of a monitor and of the interval monitor beside it."""

    inner: Any
    bounds: Any  # None without a formula to bound
    decided: Bools  # (N,) True where no later sample can change the verdict


class Deciding(Specification):
    """Specification with the robust satisfaction interval of its formula over ``length`` samples.

    The formula is that of ``judge``, the specification without its score; by default that of ``inner``. It
    may read other signals than the system's (``Specification.sample``). Without one it is never decided
    before the end.
    """

    def __init__(self, inner: Specification, length: int, judge: Specification | None = None) -> None:
        self.inner = inner
        self._judge = judge = inner if judge is None else judge
        self._bounds = judge.formula.interval_monitor(length) if judge.formula is not None else None

    def start(self, n: int) -> DecidingState:
        """Return the state before sample 0."""
        bounds = self._bounds.start(n) if self._bounds else None
        return DecidingState(self.inner.start(n), bounds, np.zeros(n, dtype=bool))

    def update(self, state: DecidingState, signals: Signals) -> tuple[DecidingState, Verdict]:
        """Return state and verdict after one more sample; for decided rows the complete rollout's verdict."""
        inner, verdict = self.inner.update(state.inner, signals)
        if self._bounds is None:
            return replace(state, inner=inner), verdict
        bounds, bounded = self._bounds.update(state.bounds, self._judge.sample(signals))
        final = np.where(bounded.decided, bounded.violated, verdict.violated)
        within = np.clip(verdict.robustness, bounded.lower, bounded.upper)
        robustness = np.where(bounded.decided, within, verdict.robustness)
        new = DecidingState(inner, bounds, bounded.decided)
        return new, replace(verdict, violated=final, robustness=robustness)

    def margin(self, state: DecidingState) -> Floats | None:
        """Return the margin of the inner specification."""
        return self.inner.margin(state.inner)
