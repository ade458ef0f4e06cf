"""Look-ahead score: robustness of the drive that would follow without any further noise.

It sees a failure that is decided but has not happened yet. Its steps are not counted as simulated ones, which
are the system's own; the counter ``look_ahead_steps`` of the result states them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from avrare.base import batch
from avrare.base.errors import AvrareError
from avrare.protocols import Floats, Signals, Specification, System, SystemWrapper, Verdict
from avrare.rollout.problem import Problem
from avrare.rollout.request import Integers

_SIGNAL = "look-ahead score"
"""Name of a signal that no formula can read."""
STEPS = "look_ahead_steps"


@dataclass(frozen=True)
class AheadState:
    """State of a system, of its monitor, and the newest look ahead.

    Attributes:
        inner: State of the system.
        monitor: State of the specification's monitor.
        t: (N,) step.
        score: (N,) minus the robustness of the newest noise-free continuation.
        looked: (N,) steps of all continuations so far.
    """

    inner: Any
    monitor: Any
    t: Integers
    score: Floats
    looked: Integers


class LookAhead(SystemWrapper):
    """System whose signals hold the score of its noise-free continuation, every so many steps."""

    def __init__(self, system: System, monitor: Specification, steps: int, every: int) -> None:
        super().__init__(system)
        self.monitor, self.steps, self.every = monitor, steps, every

    def initial(self, noise: Floats) -> AheadState:
        """Start the system."""
        zeros = np.zeros(len(noise), dtype=np.int64)
        start = self.monitor.start(len(noise))
        unknown = np.full(len(noise), -np.inf)
        return self._observed(AheadState(self.system.initial(noise), start, zeros, unknown, zeros))

    def step(self, state: AheadState, noise: Floats) -> AheadState:
        """Advance the system, and look ahead where it is time."""
        inner = self.system.step(state.inner, noise)
        return self._observed(replace(state, inner=inner, t=state.t + 1))

    def signals(self, state: AheadState) -> Signals:
        """Return the system's signals and the score."""
        return {**self.system.signals(state.inner), _SIGNAL: state.score}

    def unwrap(self, state: AheadState) -> object:
        """Return the state of the system; rows whose continuation would break down have not done so."""
        return state.inner

    def counts(self, state: AheadState) -> Mapping[str, Integers]:
        """Return the system's counters, and the steps of all looks."""
        return {**super().counts(state), STEPS: state.looked}

    def _observed(self, state: AheadState) -> AheadState:
        monitor, verdict = self.monitor.update(state.monitor, self.system.signals(state.inner))
        state, t = replace(state, monitor=monitor), int(state.t[0])
        if t == self.steps:
            return replace(state, score=-verdict.robustness)
        if t % self.every:
            return state
        score, looked = self._look(state, t), state.looked + (self.steps - t)
        return replace(state, score=np.where(np.isnan(score), state.score, score), looked=looked)

    def _look(self, state: AheadState, t: int) -> Floats:
        try:
            return self._continued(state, t)
        except (AvrareError, MemoryError):
            raise
        except Exception:  # of some row: it says nothing of the others, nor of that row's own drive
            if len(state.t) == 1:
                return np.full(1, np.nan)
            rows = [self._look(batch.take(state, np.array([k])), t) for k in range(len(state.t))]
            return np.concatenate(rows)

    def _continued(self, state: AheadState, t: int) -> Floats:
        inner, monitor = state.inner, state.monitor
        noise = np.zeros((len(state.t), self.noise_size))
        for _ in range(t, self.steps):
            inner = self.system.step(inner, noise)
            monitor, verdict = self.monitor.update(monitor, self.system.signals(inner))
        return -verdict.robustness


class _ScoredAhead(Specification):
    """Specification whose score is the largest of all looks so far."""

    def __init__(self, inner: Specification) -> None:
        self.inner, self.formula = inner, inner.formula

    def start(self, n: int) -> Any:
        return self.inner.start(n), np.full(n, -np.inf)

    def sample(self, signals: Signals) -> Signals:
        return self.inner.sample(signals)

    def update(self, state: Any, signals: Signals) -> tuple[Any, Verdict]:
        inner, verdict = self.inner.update(state[0], signals)
        score = np.fmax(state[1], signals[_SIGNAL])
        return (inner, score), replace(verdict, score=score)


class LookAheadProblem(Problem):
    """Problem whose rollouts are scored by their noise-free continuations; pickled as what it is made of.

    Args:
        target: Problem with one specification.
        every: Steps from one look to the next.
    """

    def __init__(self, target: Problem, every: int) -> None:
        self.target, self.look_every = target, every
        monitor = target.monitors[0]
        system = LookAhead(target.system, monitor, target.steps, every)
        specifications = {target.names[0]: _ScoredAhead(monitor)}
        super().__init__(system, specifications, target.steps, "robustness", chunk=target.named_chunk)

    def __reduce__(self) -> tuple[object, ...]:
        return LookAheadProblem, (self.target, self.look_every)
