"""Requirement on a parameter: the value that keeps a probability below a bound, and the trials behind it."""

from __future__ import annotations

from dataclasses import dataclass, field

from avrare.base.number_format import format_interval, format_probability
from avrare.base.records import Answer, Records
from avrare.estimation.result.intervals import Interval
from avrare.estimation.result.result import Result
from avrare_design.reweighed_trial import Nearby, Score


@dataclass(frozen=True)
class Trial:
    """Estimate at one value of the parameter.

    Attributes:
        value: The value.
        result: The estimate, at the level of all trials together.
        score: Slope there by its failures; None without a score function.
        nearby: Estimates for other values from its failures, in ascending order.
    """

    value: float
    result: Result
    score: Score | None = None
    nearby: tuple[Nearby, ...] = ()

    @property
    def interval(self) -> Interval:
        """Interval of the estimate."""
        return self.result.interval


@dataclass(frozen=True, repr=False)
class Requirement(Answer):
    """Requirement on one parameter.

    Attributes:
        parameter: Its dotted path.
        specification: Specification whose probability is bounded.
        limit: The bound.
        kept: Value nearest to the root that is shown to keep the bound; None: no value was.
        broken: Value nearest to the root that is shown to break it; None: no value was.
        root: Value at which the fitted line reaches the bound; None where it does not between the ends.
        confidence: Level of the statement.
        trials: Estimates, in the order in which they were made.
        rising: The probability rises with the parameter.
        warnings: Reasons to doubt it.
    """

    parameter: str
    specification: str
    limit: float
    kept: float | None
    broken: float | None
    root: float | None
    confidence: float
    trials: tuple[Trial, ...]
    rising: bool
    warnings: tuple[str, ...] = field(default=())

    @property
    def rollouts(self) -> int:
        """Rollouts of all trials."""
        return sum(trial.result.rollouts for trial in self.trials)

    def table(self) -> Records:
        """Return one row for each trial, in the order of the parameter."""
        return Records(
            {
                "value": trial.value,
                "probability": trial.result.probability,
                "low": trial.interval[0],
                "high": trial.interval[1],
                "rollouts": trial.result.rollouts,
                "warnings": tuple(trial.result.health),
                "reweighed": [[near.value, near.probability, *near.interval] for near in trial.nearby],
            }
            for trial in sorted(self.trials, key=lambda trial: trial.value)
        )

    def lines(self) -> list[str]:
        """Describe the answer and the trials."""
        lines = [self._answer()]
        for trial in sorted(self.trials, key=lambda trial: trial.value):
            result = trial.result
            lines.append(
                f"  {self.parameter} = {trial.value:.4g}: {format_probability(result.probability)} "
                f"({format_interval(trial.interval)}), {result.rollouts:,} rollouts"
                + (f", {', '.join(result.health)}" if result.health else "")
            )
            lines += [
                f"    reweighed for {near.value:.4g}: {format_probability(near.probability)} "
                f"({format_interval(near.interval)})"
                for near in trial.nearby
                if near.value in (self.kept, self.broken) and near.value != trial.value
            ]
        return [*lines, *(f"warning: {text}" for text in self.warnings)]

    def _answer(self) -> str:
        bound = f"p({self.specification}) < {self.limit:g}"
        most = "at most" if self.rising else "at least"
        level = f"{100 * self.confidence:g} % confidence"
        if self.kept is None:
            tried = [trial.value for trial in self.trials]
            values = f"{min(tried):g} .. {max(tried):g}"
            broken = "" if self.broken is None else f"; {self.broken:.4g} breaks it"
            return f"{self.parameter}: no value in {values} is shown to keep {bound} ({level}){broken}"
        text = f"{self.parameter} must be {most} {self.kept:.4g} for {bound} ({level}"
        if self.broken is None:
            return f"{text}); no value was shown to break it"
        return f"{text}, if p is monotone in it); {self.broken:.4g} breaks it"
