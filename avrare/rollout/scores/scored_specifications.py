"""Importance scores: how near to failure a particle has come, for setting the levels of splitting.

Any adapted score leaves the estimate unbiased; a good one spreads the particles. The running minimum of
robustness ties when the first, deterministic steps determine it, and splitting dies out on ties.
``MarginScored`` measures instead which part of the noise-free rollout's robustness is lost at each step: 0
where the particle is as safe as the noise-free one, 1 exactly where the specification is violated.

``Deciding`` reports when a verdict is final, so that a rollout may end there.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from avrare.base.errors import UsageError
from avrare.protocols import Bools, Floats, Signals, Specification, Verdict
from avrare.rollout.request import Integers

_MemoryT = TypeVar("_MemoryT")
_History = dict[str, NDArray[Any]]
ScoreFunction = Callable[[_History, int], Floats]
"""``function(signals so far, t) -> (N,)``; signals have shape (N, t + 1, ...)."""


@dataclass(frozen=True)
class ScoredState(Generic[_MemoryT]):
    """State of a specification that defines its score."""

    inner: object
    score: Floats  # (N,) running score
    memory: _MemoryT  # further state of the score


class _Scored(Specification, Generic[_MemoryT]):
    def __init__(self, inner: Specification) -> None:
        self.inner = inner

    def start(self, n: int) -> ScoredState[_MemoryT]:
        """Return the state before sample 0."""
        return ScoredState(self.inner.start(n), np.full(n, -np.inf), self._start_memory(n))

    def update(self, state: ScoredState[_MemoryT], signals: Signals) -> tuple[ScoredState[_MemoryT], Verdict]:
        """Return state and verdict after one more sample."""
        inner, verdict = self.inner.update(state.inner, signals)
        score, memory = self._score(state, inner, signals)
        return ScoredState(inner, score, memory), replace(verdict, score=score)

    def margin(self, state: ScoredState[_MemoryT]) -> Floats | None:
        """Return the margin of the inner specification."""
        return self.inner.margin(state.inner)

    def _start_memory(self, n: int) -> _MemoryT:
        raise NotImplementedError

    def _score(
        self, state: ScoredState[_MemoryT], inner: object, signals: Signals
    ) -> tuple[Floats, _MemoryT]:
        raise NotImplementedError


class MarginScored(_Scored[Integers]):
    """Specification "always φ", scored by the lost share of the noise-free margin.

    ``nominal`` is the robustness (steps + 1,) of φ along the noise-free rollout, positive.
    """

    def __init__(self, inner: Specification, nominal: Floats) -> None:
        super().__init__(inner)
        finite = nominal[np.isfinite(nominal)]
        self.nominal = np.where(np.isfinite(nominal), nominal, finite.max() if finite.size else 1.0)

    def _start_memory(self, n: int) -> Integers:
        return np.zeros(n, dtype=np.int64)

    def _score(
        self, state: ScoredState[Integers], inner: object, signals: Signals
    ) -> tuple[Floats, Integers]:
        margin = self.inner.margin(inner)
        if margin is None:
            raise TypeError("a margin score needs a formula of the shape `always ...`")
        lost = 1.0 - margin / self.nominal[np.minimum(state.memory, len(self.nominal) - 1)]
        return np.fmax(state.score, lost), state.memory + 1


class PrefixScored(Specification):
    """Specification scored by minus the robustness of the current prefix, which may fall again.

    Do not estimate with it: levels on it are biased where a formula may still become true. The published
    form of splitting orders particles by it.
    """

    def __init__(self, inner: Specification) -> None:
        self.inner = inner

    def start(self, n: int) -> object:
        """Return the state before sample 0."""
        return self.inner.start(n)

    def update(self, state: object, signals: Signals) -> tuple[object, Verdict]:
        """Return state and verdict after one more sample."""
        state, verdict = self.inner.update(state, signals)
        return state, replace(verdict, score=-verdict.robustness)


class FormulaScored(_Scored[object]):
    """Specification scored by another formula, which only orders the particles."""

    def __init__(self, inner: Specification, guide: Specification) -> None:
        super().__init__(inner)
        self.guide = guide

    def _start_memory(self, n: int) -> object:
        return self.guide.start(n)

    def _score(self, state: ScoredState[object], inner: object, signals: Signals) -> tuple[Floats, object]:
        memory, guide = self.guide.update(state.memory, signals)
        return guide.score, memory


class FunctionScored(_Scored[_History | None]):
    """Specification scored by the running maximum of a function of the signals so far."""

    def __init__(self, inner: Specification, function: ScoreFunction) -> None:
        super().__init__(inner)
        self.function = function

    def _start_memory(self, n: int) -> None:
        return None

    def _score(
        self, state: ScoredState[_History | None], inner: object, signals: Signals
    ) -> tuple[Floats, _History]:
        history = {name: np.array(values)[:, None] for name, values in signals.items()}
        if state.memory is not None:
            history = {
                name: np.concatenate([state.memory[name], values], axis=1) for name, values in history.items()
            }
        t = next(iter(history.values())).shape[1] - 1
        hint = "it gets the signals so far, (N, t + 1, ...) each, and t; it must return (N,)"
        try:
            value = np.asarray(self.function(history, t), dtype=np.float64)
        except (Exception, SystemExit) as error:
            reason = f"{type(error).__name__}: {error}"
            raise UsageError(f"the score function raised at step {t}: {reason}", hint) from error
        if value.shape != state.score.shape:
            raise UsageError(
                f"the score function returned shape {value.shape} for {len(state.score)} particles",
                hint,
            )
        return np.fmax(state.score, value), history


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
