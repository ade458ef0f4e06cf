"""Learned score of splitting: the committor that a network reads off the features of a state.

A learning run of splitting by the problem's own score comes first and does not count. All its rollouts, the
discarded ones with the weights that they had, teach a network the probability of a failure (``smc.network``).
Its log odds, the largest so far, are then the score, with every failure above all of them. Splitting is
unbiased for any score that was fixed before.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from avrare.base import batch
from avrare.base.errors import UsageError
from avrare.estimation.plan.plan import Info, Plan
from avrare.estimation.result.note import Note
from avrare.protocols import Bools, Floats
from avrare.rollout.request import Integers, Rollouts
from avrare_estimators.ams.gain import Promise, promise_gain
from avrare_estimators.ams.population import Branches, Population
from avrare_estimators.common.committor.learned_file import FILE, Learned, LearnedFile
from avrare_estimators.common.committor.potentials import Paths, Potentials, learn

LEARNING_RUN = 2**31 + 2**16
"""Address of the noise of runs that only teach, far from those that count and from the pilot."""
MOST_TIMES = 50
"""Most steps of a rollout at which the committor is looked up."""
MOST_PATHS = 16
"""Most rollouts of a learning run, in multiples of its particles."""
_TRAINING = 6000
"""Most steps of training: a score must order rollouts that a potential need only tell apart."""
_LEAST_GAIN = 1.2
"""Gain over the problem's own score, less its standard error, from which the learned score is kept."""


def choose_times(steps: int) -> Integers:
    """Return the steps (K,) before the last at which the committor is looked up."""
    wanted = np.linspace(0.0, max(steps - 1, 0), min(steps, MOST_TIMES))
    return np.unique(np.round(wanted).astype(np.int64))


class PathTable:
    """Rollouts of a learning run: those of all slots, and the discarded; written in place."""

    def __init__(self, slots: int, schedule: Integers) -> None:
        self.schedule = schedule
        self.features: NDArray[Any] = np.zeros((slots, len(schedule), 0), dtype=np.float32)
        self.score = np.full(slots, -np.inf)
        self._retired: list[Paths] = []

    def store(self, pending: Branches, rollouts: Rollouts) -> None:
        """Write the rollouts of ``pending``, whose past the slots have inherited."""
        if width := rollouts.features.shape[2]:  # 0 where no row lived to be observed
            if not self.features.shape[2]:
                self.features = np.full((*self.features.shape[:2], width), np.nan, dtype=np.float32)
            new = (self.schedule > pending.start[:, None])[..., None]
            old = self.features[pending.slots]
            self.features[pending.slots] = np.where(new, rollouts.features, old)
        self.score[pending.slots] = rollouts.scores[:, -1]

    def inherit(self, branches: Branches) -> None:
        """Give the children the past of their parents; what is later than their start is written anew."""
        self.features[branches.slots] = self.features[branches.parents]

    def retire(self, discarded: Bools, weight: float, population: Population) -> None:
        """Keep the discarded rollouts with the weight of their run."""
        slots = np.flatnonzero(discarded & ~population.error)
        self._retired.append(self._paths(slots, weight, population))

    def finish(self, weight: float, population: Population) -> Paths:
        """Return all rollouts of a run that has ended."""
        self.retire(np.ones(len(self.score), dtype=bool), weight, population)
        paths: Paths = batch.concatenate(self._retired)
        return replace(paths, weights=paths.weights * len(paths.weights))

    @property
    def full(self) -> bool:
        """True where no further rollouts should come."""
        rollouts = len(self.score) + sum(len(paths.score) for paths in self._retired)
        return rollouts > (MOST_PATHS - 1) * len(self.score)

    def _paths(self, slots: Integers, weight: float, population: Population) -> Paths:
        weights = np.full(len(slots), weight / len(self.score))
        violated, root = population.violated[slots], population.root[slots]
        return Paths(self.features[slots], self.score[slots], violated, weights, root)


@dataclass(frozen=True)
class ScoreLearning:
    """Learned score, or the state of its learning.

    Attributes:
        schedule: (K,) steps at which the committor is looked up.
        table: Rollouts of the learning run under way; None: it has ended, or a file was given.
        potentials: The score, where it is used; None: the problem's own.
        promise: Gain that held-out rollouts promise; None: not known.
        reason: Why it is used, or is not.
        spent: Cost of the learning run.
    """

    schedule: Integers
    table: PathTable | None = None
    potentials: Potentials | None = None
    promise: Promise | None = None
    reason: str = ""
    spent: Info = field(default_factory=Info)

    @staticmethod
    def begin(plan: Plan, particles: int) -> ScoreLearning:
        """Begin with a learning run of so many particles."""
        schedule = choose_times(plan.steps)
        return ScoreLearning(schedule, PathTable(particles, schedule))

    @staticmethod
    def given(file: LearnedFile, plan: Plan, features: int | None) -> ScoreLearning:
        """Return the score of a file.

        Raises:
            UsageError: The file does not fit, or what it holds ends short of failure.
        """
        potentials = file.find(plan, features).potentials
        if potentials is None or not potentials.reached:
            raise UsageError(
                f"learned: {file.path}: {plan.names[0]} has no potentials that reach to failure",
                "give the learned.json of a run with `score: learned`, or leave `learned` out to learn again",
            )
        return ScoreLearning(potentials.schedule, None, potentials, reason="it was given")

    @property
    def observed(self) -> tuple[int, ...]:
        """Steps whose features are wanted."""
        wanted = self.table is not None or self.potentials is not None
        return tuple(self.schedule.tolist()) if wanted else ()

    def told(self, rollouts: Rollouts, pending: Branches, population: Population) -> Rollouts:
        """Record the rollouts of a learning run; give others the learned score."""
        if self.table is not None:
            self.table.store(pending, rollouts)
        if self.potentials is None:
            return rollouts
        start = pending.start
        before = np.where(start < 0, -np.inf, population.scores[pending.slots, np.maximum(start, 0)])
        return replace(rollouts, scores=committor_scores(self.potentials, rollouts, start, before))

    def ended(self, plan: Plan, weight: float, population: Population, spent: Info) -> ScoreLearning:
        """Learn from the run that has ended, and decide on the score."""
        assert self.table is not None
        paths = self.table.finish(weight, population)
        state = replace(self, table=None, spent=spent)
        seed = (plan.noise.seed, LEARNING_RUN)
        potentials = learn((paths,), self.schedule, seed, _TRAINING) if len(paths.score) else None
        if potentials is None or not potentials.reached:
            return replace(state, reason="the learning run met too few failures")
        if not potentials.useful:
            return replace(state, reason="the features do not tell failures before they happen")
        promise = promise_gain(potentials, paths, plan.steps)
        gain = f"a gain of {promise.gain:.2g} ± {promise.error:.1g}"
        if promise.sure < _LEAST_GAIN:
            reason = f"rollouts held out promise {gain}, which is not surely {_LEAST_GAIN}"
            return replace(state, promise=promise, reason=reason)
        return replace(
            state, potentials=potentials, promise=promise, reason=f"rollouts held out promise {gain}"
        )

    def diagnostics(self, plan: Plan) -> dict[str, object]:
        """Return the score in use and its promise, as JSON."""
        learned = self.potentials is not None
        score: dict[str, Any] = {"used": "learned" if learned else "problem", "reason": self.reason}
        diagnostics: dict[str, Any] = {"score": score, "learning_rollouts": self.spent.rollouts}
        if self.promise is not None:
            error = self.promise.error
            score |= {"gain": self.promise.gain, "gain_error": error if np.isfinite(error) else None}
        if self.potentials is not None:
            diagnostics["learned"] = _freeze(self.potentials, plan).digest
        return diagnostics

    def notes(self) -> tuple[Note, ...]:
        """Return the note on the score in use."""
        own = "the problem's own, not the learned committor"
        score = own if self.potentials is None else "the learned committor"
        return (Note("score", f"The score is {score}: {self.reason}."),)

    def artifacts(self, plan: Plan) -> dict[str, object]:
        """Return the file of the score, for ``learned: FILE``."""
        if self.potentials is None:
            return {}
        return {FILE: _freeze(self.potentials, plan).to_dict(None)}


def _freeze(potentials: Potentials, plan: Plan) -> Learned:
    return Learned(None, potentials, (0.0,), (plan.steps + 1, plan.noise.noise_size))


def committor_scores(potentials: Potentials, rollouts: Rollouts, start: Integers, before: Floats) -> Floats:
    """Return running scores (n, T + 1): the largest log odds of a failure so far, infinite for failures.

    Args:
        potentials: What was learnt.
        rollouts: Rollouts with the features at its steps.
        start: (n,) step that each branched at; -1: at the beginning.
        before: (n,) score at that step.
    """
    scores = np.full((len(start), rollouts.scores.shape[1]), -np.inf)
    if rollouts.features.shape[2]:  # else all branched later than at the last of these steps
        later = (potentials.schedule > start[:, None]) & ~np.isnan(rollouts.features[:, :, -1])
        rows, times = np.nonzero(later)
        odds = potentials.log_odds(times, rollouts.features[rows, times])
        scores[rows, potentials.schedule[times]] = odds
    np.maximum.accumulate(scores, axis=1, out=scores)
    np.maximum(scores, before[:, None], out=scores)
    scores[rollouts.violated[:, 0], -1] = np.inf
    return scores
