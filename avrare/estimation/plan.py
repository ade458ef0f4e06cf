"""What the estimation loop and an estimator tell each other."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

from avrare.estimation.budget import Budget
from avrare.estimation.result import Result
from avrare.rollout.noise import NoiseSource
from avrare.rollout.request import Request, Rollouts, total_counts


@dataclass(frozen=True)
class Plan:
    """The task of an estimator.

    Attributes:
        names: Names of the problem's specifications.
        steps: Steps of a rollout.
        chunk: Rollouts per unit of work.
        noise: Where the tapes come from.
        confidence: Of the interval.
        budget: Upper bound on cost, or None for the estimator's own options.
        max_error_rate: Share of broken rollouts above which the result is unhealthy.
    """

    names: tuple[str, ...]
    steps: int
    chunk: int
    noise: NoiseSource
    confidence: float
    budget: Budget | None
    max_error_rate: float


@dataclass(frozen=True)
class Info:
    """What a reader wants to see while it runs; any field may be None.

    Attributes:
        stage: Stages done.
        level: Current level of the score.
        probability: Estimate so far.
        survivors: Particles that outlived the last level.
        particles: Particles in all.
        rollouts: Rollouts done.
        failures: Failing rollouts seen.
        errors: Rollouts that broke down.
        goal: Rollouts planned, where known.
        counts: The system's counters, summed.
    """

    stage: int = 0
    level: float | None = None
    probability: float | None = None
    survivors: int | None = None
    particles: int | None = None
    rollouts: int = 0
    failures: int = 0
    errors: int = 0
    goal: int | None = None
    counts: Mapping[str, int] = field(default_factory=dict)

    def plus(self, outcome: Rollouts) -> Info:
        """With more rollouts done."""
        new = total_counts([outcome])
        names = sorted({*self.counts, *new})
        return replace(
            self,
            rollouts=self.rollouts + len(outcome.error),
            failures=self.failures + int(outcome.violated.any(axis=1).sum()),
            errors=self.errors + int(outcome.error.sum()),
            counts={name: self.counts.get(name, 0) + new.get(name, 0) for name in names},
        )


class Estimator(Protocol):
    """An estimator owns no loop: it asks for rollouts and is told their outcome.

    ``single`` is True when it estimates one specification at a time.
    """

    name: str
    single: bool

    def init(self, plan: Plan) -> tuple[Any, Info]:
        """State before the first rollout, and what to show."""

    def ask(self, state: Any) -> Request | None:
        """The next rollouts, or None when done."""

    def tell(self, state: Any, rollouts: Rollouts) -> tuple[Any, Info]:
        """State after the rollouts asked for, and what to show."""

    def estimate(self, state: Any) -> list[Result]:
        """One result per specification."""


class Journal(Protocol):
    """Where the outcomes of chunks are kept, so that an estimate can be interrupted and gone on with.

    An estimator is a deterministic function of the outcomes that it is told: nothing of its state is kept.
    Carries are not kept either. A stage whose request asks for them is run again, unless the estimator has
    ``rebuilds_carries = True``: it then does without those that it was not given.
    """

    def read(self, stage: int, index: int, chunk: Request) -> tuple[Rollouts, float] | None:
        """The outcome of a chunk and the seconds that had passed by then; None where it is not kept.

        Raises:
            AvrareError: Something else is kept in its place.
        """

    def write(self, stage: int, index: int, chunk: Request, outcome: Rollouts, seconds: float) -> None:
        """Keep the outcome of chunk number ``index`` of a stage.

        Raises:
            AvrareError: It cannot be kept.
        """
