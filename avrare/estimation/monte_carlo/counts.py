"""Outcomes of independent rollouts, summed up as they arrive: memory that does not grow with their number."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from avrare.protocols import Bools, Floats
from avrare.rollout.request import Integers, Rollouts

MOST_ROBUSTNESS = 100_000
"""Rollouts whose robustness is kept, the first ones."""


@dataclass(frozen=True)
class Rows:
    """Some rollouts and their robustness.

    Attributes:
        index: (F,) ascending.
        robustness: (F,).
    """

    index: Integers
    robustness: Floats

    def plus(self, index: Integers, robustness: Floats) -> Rows:
        """Return these rollouts and later ones."""
        return Rows(np.concatenate([self.index, index]), np.concatenate([self.robustness, robustness]))

    def before(self, end: int) -> Rows:
        """Return the rows with an index below ``end``."""
        place = int(np.searchsorted(self.index, end))
        return Rows(self.index[:place], self.robustness[:place])


_NONE = Rows(np.zeros(0, dtype=np.int64), np.zeros(0))


@dataclass(frozen=True)
class Counts:
    """Outcomes of the rollouts so far, for S specifications.

    Attributes:
        per_run: Rollouts of a run.
        keep: Failures of each specification to keep.
        ordered: Keep the verdicts of all rollouts, from which a stopping rule chooses the first ones.
        trials: Number of rollouts.
        errors: Number that broke down.
        failures: (R, S) failing rollouts of each run that has begun.
        robustness: Parts (n, S) of the first rollouts, NaN for errors.
        failing: The first failures of each specification.
        records: Rollouts less robust than all before them, of each specification; the last one alone unless
            ``ordered``.
        verdicts: Parts (violated (n, S), error (n,)), if ``ordered``.
        messages: Causes of the first few errors.
    """

    per_run: int
    keep: int
    ordered: bool
    trials: int = 0
    errors: int = 0
    failures: Integers | None = None
    robustness: tuple[Floats, ...] = ()
    failing: tuple[Rows, ...] = ()
    records: tuple[Rows, ...] = ()
    verdicts: tuple[tuple[Bools, Bools], ...] = ()
    messages: tuple[str, ...] = ()

    def plus(self, outcome: Rollouts) -> Counts:
        """Return the counts with the outcome of the next rollouts."""
        violated, error = outcome.violated, outcome.error
        robustness = np.where(error[:, None], np.nan, outcome.robustness)
        room = max(0, MOST_ROBUSTNESS - self.trials)
        return replace(
            self,
            trials=self.trials + len(error),
            errors=self.errors + int(error.sum()),
            failures=self._failures(violated),
            robustness=(*self.robustness, robustness[:room]) if room else self.robustness,
            failing=self._failing(violated, robustness),
            records=self._records(robustness),
            verdicts=(*self.verdicts, (violated, error)) if self.ordered else (),
            messages=tuple(dict.fromkeys((*self.messages, *outcome.messages)))[:5],
        )

    def probabilities(self, column: int) -> Floats:
        """Return the share of failures (R,) in each run."""
        assert self.failures is not None
        rows = self.trials - self.per_run * np.arange(len(self.failures))
        return np.asarray(self.failures[:, column] / np.minimum(rows, self.per_run))

    def join_robustness(self, column: int, end: int) -> Floats:
        """Return the robustness of the first rollouts, NaN for errors."""
        return np.concatenate([part[:, column] for part in self.robustness])[:end]

    def join_verdicts(self) -> tuple[Bools, Bools]:
        """Return violated (n, S) and error (n,) of all rollouts."""
        violated, error = zip(*self.verdicts, strict=True)
        return np.concatenate(violated), np.concatenate(error)

    def _failures(self, violated: Bools) -> Integers:
        run = (self.trials + np.arange(len(violated))) // self.per_run
        first, sums = int(run[0]), np.add.reduceat(violated, np.searchsorted(run, np.unique(run)), dtype=int)
        before = np.zeros((first, violated.shape[1]), int) if self.failures is None else self.failures
        if len(before) > first:  # the run that was under way
            sums[0] += before[first]
        return np.concatenate([before[:first], sums])

    def _failing(self, violated: Bools, robustness: Floats) -> tuple[Rows, ...]:
        failing = list(self.failing or [_NONE] * violated.shape[1])
        for column in np.flatnonzero(violated.any(axis=0)):
            rows = np.flatnonzero(violated[:, column])[: max(0, self.keep - len(failing[column].index))]
            failing[column] = failing[column].plus(self.trials + rows, robustness[rows, column])
        return tuple(failing)

    def _records(self, robustness: Floats) -> tuple[Rows, ...]:
        records = list(self.records or [_NONE] * robustness.shape[1])
        least = np.array([rows.robustness[-1] if len(rows.index) else np.nan for rows in records])
        before = np.fmin.accumulate(np.concatenate([least[None], robustness]))[:-1]
        less = (robustness < before) | (np.isnan(before) & ~np.isnan(robustness))
        for column in np.flatnonzero(less.any(axis=0)):
            rows = np.flatnonzero(less[:, column])[None if self.ordered else -1 :]
            earlier = records[column] if self.ordered else _NONE
            records[column] = earlier.plus(self.trials + rows, robustness[rows, column])
        return tuple(records)


def monte_carlo_cost(probability: float, relative_error: float) -> int | None:
    """Return the rollouts with which Monte Carlo is as exact; None if unknown."""
    if not (probability > 0.0 and relative_error > 0.0 and math.isfinite(relative_error)):
        return None
    return round_to_two_digits((1.0 - probability) / probability / relative_error**2)


def round_to_two_digits(number: float) -> int:
    """Round a positive number to two digits."""
    return int(float(f"{number:.1e}"))
