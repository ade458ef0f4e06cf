"""Interface of the estimation loop and its estimators: settings, plan, progress, forecast, journal."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal, NamedTuple, Protocol

from avrare import protocols
from avrare.base.errors import AvrareError, UsageError
from avrare.estimation.plan.budget import Budget
from avrare.estimation.result.fresh_rows import NO_ROWS, FreshRows
from avrare.estimation.result.result import Result
from avrare.rollout.noise import NoiseSource
from avrare.rollout.request import Request, Rollouts

DEFAULT_MAX_ERROR_RATE = 0.01


@dataclass(frozen=True)
class Settings:
    """Settings that all estimators share.

    Attributes:
        seed: Seed of all random numbers.
        confidence: Level of the intervals, in (0, 1).
        budget: Upper bound on cost.
        max_error_rate: Share of errors among the rollouts above which a result has the warning ``errors``.
        suppress: Names of health warnings to leave out.
        seen: Counts of rollouts of the target from before (``Plan.seen``).
        goal: Relative error for an estimator that is given neither its size nor a budget; None: its own.
    """

    seed: int = 0
    confidence: float = 0.95
    budget: Budget | None = None
    max_error_rate: float = DEFAULT_MAX_ERROR_RATE
    suppress: tuple[str, ...] = ()
    seen: FreshRows = NO_ROWS
    goal: float | None = None


@dataclass(frozen=True)
class CostForecast:
    """Whole cost of an estimate, as far as it is certain before its end.

    Attributes:
        kind: Unit of the amounts: "rollouts", "steps" (simulated ones) or "seconds".
        least: Amount that the estimate is expected to take at least.
        most: Amount at most; infinite where nothing limits it yet.
        given: Evidence for the amounts, such as "p 0.01 .. 1e-06"; empty where they are firm.
    """

    kind: Literal["rollouts", "steps", "seconds"]
    least: float
    most: float
    given: str = ""

    def after(self, rollouts: int, steps: int) -> CostForecast:
        """Return the forecast of an estimate of which parts at this cost are done."""
        done = {"rollouts": rollouts, "steps": steps, "seconds": 0}[self.kind]
        return replace(self, least=self.least + done, most=self.most + done)


_MAX_MESSAGES = 5
FAILURE_LIMIT = 100
"""Failing tapes that a result keeps at most."""


@dataclass(frozen=True)
class Plan:
    """Task of an estimator.

    Attributes:
        names: Names of the problem's specifications.
        steps: Steps of a rollout.
        chunk: Largest number of rollouts per unit of work; the same for any number of workers.
        noise: Source of the noise tapes.
        confidence: Level of the interval, in (0, 1).
        budget: Upper bound on cost, or None for the estimator's own options. With one of seconds,
            requests are answered in part, by their first rows, where the time does not pay for all.
        max_error_rate: Share of errors among the rollouts above which the result has the warning ``errors``.
        seen: Counts of rollouts of the target from before the estimate: not part of it, they vouch for it or
            contradict it, and count in the blind bound.
    """

    names: tuple[str, ...]
    steps: int
    chunk: int
    noise: NoiseSource
    confidence: float
    budget: Budget | None
    max_error_rate: float
    seen: FreshRows = NO_ROWS

    @property
    def tape_bytes(self) -> int:
        """Bytes of a noise tape."""
        return 8 * (self.steps + 1) * max(self.noise.noise_size, 1)

    @property
    def kept_failures(self) -> int:
        """Number of failing tapes that a result keeps at most: fewer where they are long."""
        # bytes of the tapes that the results keep together
        room = 2**28 // (self.tape_bytes * len(self.names))
        return max(1, min(FAILURE_LIMIT, room))


@dataclass(frozen=True)
class Info:
    """Totals and progress of an estimate; None where a field does not apply.

    Attributes:
        stage: Stages done.
        level: Current level of the score.
        probability: Estimate so far.
        survivors: Particles that survived the last level.
        particles: Number of particles.
        rollouts: Rollouts done: starts and branches, each counted as one.
        steps: Simulated steps.
        failures: Failing rollouts.
        errors: Rollouts that ended in an error.
        goal: Rollouts planned, where known.
        forecast: Bounds on the whole cost, where the rollouts are not planned.
        stage_rows: Rollouts of the stage under way, where it has several chunks.
        stage_done: Those of them that are done.
        counts: The system's counters, summed.
        messages: The first error messages.
    """

    stage: int = 0
    level: float | None = None
    probability: float | None = None
    survivors: int | None = None
    particles: int | None = None
    rollouts: int = 0
    steps: int = 0
    failures: int = 0
    errors: int = 0
    goal: int | None = None
    forecast: CostForecast | None = None
    stage_rows: int = 0
    stage_done: int = 0
    counts: Mapping[str, int] = field(default_factory=dict)
    messages: tuple[str, ...] = ()

    def plus(self, outcome: Rollouts) -> Info:
        """Return the progress after more rollouts."""
        counts = Counter(self.counts)
        counts.update({name: int(values.sum()) for name, values in outcome.counts.items()})
        return replace(
            self,
            rollouts=self.rollouts + len(outcome.error),
            steps=self.steps + outcome.simulated_steps,
            failures=self.failures + int(outcome.violated.any(axis=1).sum()),
            errors=self.errors + int(outcome.error.sum()),
            counts=dict(sorted(counts.items())),
            messages=(*self.messages, *outcome.messages)[:_MAX_MESSAGES],
        )

    def before(self, other: Info) -> Info:
        """Return the progress of a later part ``other`` with the cost of both."""
        counts = Counter(self.counts)
        counts.update(other.counts)
        return replace(
            other,
            rollouts=self.rollouts + other.rollouts,
            steps=self.steps + other.steps,
            failures=self.failures + other.failures,
            errors=self.errors + other.errors,
            goal=None if other.goal is None else self.rollouts + other.goal,
            forecast=other.forecast and other.forecast.after(self.rollouts, self.steps),
            counts=dict(sorted(counts.items())),
            messages=(*self.messages, *other.messages)[:_MAX_MESSAGES],
        )


Estimator = protocols.Estimator[Plan, Request, Rollouts, Info, Result]
"""An estimator of failure probabilities."""


Execute = Callable[[Any, Estimator, Any, str], list[Result]]
"""Runs an estimator on a problem with some settings, as the part of an estimate that has this name.

It raises ``Refused`` where the part cannot begin."""


class Refused(UsageError):
    """A part of an estimate that cannot begin: no rollout of it has run."""


class GaveUp(AvrareError):
    """An estimator's word that it has nothing to gain on a problem, before any rollout that would count.

    Attributes:
        info: Cost until then.
        seconds: Wall time until then [s].
    """

    info = Info()
    seconds = 0.0

    @classmethod
    def after(cls, info: Info, message: str, hint: str) -> GaveUp:
        """Return the error with the cost until then."""
        error = cls(message, hint)
        error.info = info
        return error


class StoredChunk(NamedTuple):
    """Chunk of a request with its outcome.

    Attributes:
        request: The chunk.
        outcome: Its outcome.
        seconds: Wall time of the estimate until then [s].
    """

    request: Request
    outcome: Rollouts
    seconds: float


class Journal(Protocol):
    """Store of chunk outcomes, from which an interrupted estimate resumes.

    An estimator is a deterministic function of the outcomes that it gets: its state is not stored. Nor are
    carries: a stage whose request asks for them is run again, unless the estimator has
    ``rebuilds_carries = True`` and so manages without them.
    """

    def read(self, stage: int, request: Request) -> Iterator[StoredChunk]:
        """Yield the stored chunks of a stage's request, in order."""

    def part(self, name: str) -> Journal:
        """Return the journal of a part of the estimate."""

    def has(self, stage: int) -> bool:
        """Return whether chunks of a stage are stored."""

    def write(self, stage: int, index: int, chunk: Request, outcome: Rollouts, seconds: float) -> None:
        """Store the outcome of chunk number ``index`` of a stage."""
