"""Importance scores: how near to failure a particle has come, for setting the levels of splitting.

Any adapted score leaves the estimate unbiased; a good one spreads the particles. The running minimum of
robustness ties when the first, deterministic steps fix it, and splitting dies out on ties. ``MarginScored``
measures instead which part of the noise-free drive's robustness is lost at each step: 0 where the particle is
as safe as the noise-free one, 1 exactly where the rule is broken.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np

from avrare.errors import UsageError
from avrare.protocols import Floats, Signals, Specification, Verdict

ScoreFunction = Callable[[dict[str, Any], int], Floats]
"""``function(signals so far, t) -> (N,)``; signals have shape (N, t + 1, ...)."""
_SCORE_HINT = "it gets the signals so far, (N, t + 1, ...) each, and t; it must return (N,)"


class SteppedSpecification(Specification, Protocol):
    """A specification of the shape "always φ" that tells φ of the newest sample."""

    def margin(self, state: Any) -> Floats | None:
        """(N,) robustness of φ at the newest sample, None for other shapes."""


@dataclass(frozen=True)
class ScoredState:
    """State of a specification with a score of its own: inner monitor, running score, memory."""

    inner: Any
    score: Floats
    memory: Any


class MarginScored:
    """Scores by the lost share of the nominal margin.

    Args:
        inner: Specification of the shape "always φ".
        nominal: (steps + 1,) φ along the noise-free run, positive.
    """

    def __init__(self, inner: SteppedSpecification, nominal: Floats) -> None:
        self.inner = inner
        finite = nominal[np.isfinite(nominal)]
        self.nominal = np.where(np.isfinite(nominal), nominal, finite.max() if finite.size else 1.0)

    def start(self, n: int) -> ScoredState:
        """Before sample 0."""
        return ScoredState(self.inner.start(n), np.full(n, -np.inf), np.zeros(n, dtype=np.int64))

    def update(self, state: ScoredState, signals: Signals) -> tuple[ScoredState, Verdict]:
        """After one more sample."""
        inner, verdict = self.inner.update(state.inner, signals)
        margin = self.inner.margin(inner)
        if margin is None:
            raise TypeError("a margin score needs a formula of the shape `always ...`")
        lost = 1.0 - margin / self.nominal[np.minimum(state.memory, len(self.nominal) - 1)]
        score = np.fmax(state.score, lost)
        return ScoredState(inner, score, state.memory + 1), replace(verdict, score=score)


class PrefixScored:
    """Scores by minus the robustness of the prefix as it stands: it may fall again.

    No score to estimate with: levels on it are biased where a formula may still come true. It is what the
    published form of splitting orders by.
    """

    def __init__(self, inner: Specification) -> None:
        self.inner = inner

    def start(self, n: int) -> Any:
        """Before sample 0."""
        return self.inner.start(n)

    def update(self, state: Any, signals: Signals) -> tuple[Any, Verdict]:
        """After one more sample."""
        state, verdict = self.inner.update(state, signals)
        return state, replace(verdict, score=-verdict.robustness)


class FormulaScored:
    """Scores by how near another formula has come to failing, which decides nothing but the order.

    Args:
        inner: The specification that is estimated.
        guide: A monitor whose score is followed.
    """

    def __init__(self, inner: Specification, guide: Specification) -> None:
        self.inner = inner
        self.guide = guide

    def start(self, n: int) -> ScoredState:
        """Before sample 0."""
        return ScoredState(self.inner.start(n), np.full(n, -np.inf), self.guide.start(n))

    def update(self, state: ScoredState, signals: Signals) -> tuple[ScoredState, Verdict]:
        """After one more sample."""
        inner, verdict = self.inner.update(state.inner, signals)
        guide, guided = self.guide.update(state.memory, signals)
        return ScoredState(inner, guided.score, guide), replace(verdict, score=guided.score)


class FunctionScored:
    """Scores by a function of the signals so far, made adapted and monotone by a running maximum."""

    def __init__(self, inner: Specification, function: ScoreFunction) -> None:
        self.inner = inner
        self.function = function

    def start(self, n: int) -> ScoredState:
        """Before sample 0."""
        return ScoredState(self.inner.start(n), np.full(n, -np.inf), None)

    def update(self, state: ScoredState, signals: Signals) -> tuple[ScoredState, Verdict]:
        """After one more sample."""
        inner, verdict = self.inner.update(state.inner, signals)
        history = {name: np.array(values)[:, None] for name, values in signals.items()}
        if state.memory is not None:
            history = {
                name: np.concatenate([state.memory[name], values], axis=1) for name, values in history.items()
            }
        t = next(iter(history.values())).shape[1] - 1
        try:
            value = np.asarray(self.function(history, t), dtype=np.float64)
        except Exception as error:
            reason = f"{type(error).__name__}: {error}"
            raise UsageError(f"the score function raised at step {t}: {reason}", _SCORE_HINT) from error
        if value.shape != state.score.shape:
            raise UsageError(
                f"the score function returned shape {value.shape} for {len(state.score)} particles",
                _SCORE_HINT,
            )
        score = np.fmax(state.score, value)
        return ScoredState(inner, score, history), replace(verdict, score=score)
