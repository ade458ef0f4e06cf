"""Costs of estimates for a relative error of 20 %, and their table."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from avrare.protocols import Floats
from benchmarks.studies import kept

GOAL = 0.2
_HEADS = (
    "stack", "p", "estimator", "results", "chosen", "mean / p", "cover", "warned", "CW", "cost, stated",
    "cost, by scatter", "over the better of `mc` and `ams`",
)  # fmt: skip
_KINDS = ("stated", "by scatter")
FACTOR = 3.0
"""Confidently wrong: no warning, and the interval misses the truth by more than this factor."""
LEAST = 5
"""Results from which a scatter says something."""


@dataclass(frozen=True)
class Outcome:
    """One result.

    Attributes:
        seed: Number of the result in its cell.
        truth: Known probability.
        chosen: Estimator, and whether chains climbed.
        probability: Estimate.
        low: Lower end of the 95 % interval.
        high: Upper end.
        relative_error: Its own.
        rollouts: Cost in steps over those of a rollout, choice, learning and checks included.
        learning: Rollouts of choice and learning.
        health: Warnings.
        seconds: Processor time.
    """

    seed: int
    truth: float
    chosen: str
    probability: float
    low: float
    high: float
    relative_error: float
    rollouts: float
    learning: int
    health: tuple[str, ...]
    seconds: float

    @property
    def covers(self) -> bool:
        """True where the interval holds the truth."""
        return self.low <= self.truth <= self.high

    @property
    def misleads(self) -> bool:
        """True where it is confidently wrong."""
        far = self.low > FACTOR * self.truth or self.high * FACTOR < self.truth
        return far and not self.health


def read(file: Path) -> list[Outcome]:
    """Read the outcomes of a cell, in the order of their seeds; a torn line is left out."""
    found = (Outcome(**{**fields, "health": tuple(fields["health"])}) for fields in kept.lines(file))
    return sorted(found, key=lambda one: one.seed)


@dataclass(frozen=True)
class Costs:
    """Results of an estimator on a stack.

    Attributes:
        found: The results.
    """

    found: list[Outcome]

    @property
    def truth(self) -> float:
        """Known probability."""
        return self.found[0].truth

    @property
    def monte_carlo(self) -> float:
        """Rollouts of Monte Carlo."""
        return (1.0 - self.truth) / self.truth / GOAL**2

    @property
    def stated(self) -> Floats:
        """Rollouts by the relative errors that the results state, each."""
        return np.array([(one.relative_error / GOAL) ** 2 * one.rollouts for one in self.found])

    @property
    def scattered(self) -> Floats:
        """Rollouts by the squared error of each result; their mean is what the scatter says."""
        cost = np.mean([one.rollouts for one in self.found])
        return np.array([(one.probability / self.truth - 1.0) ** 2 for one in self.found]) * cost / GOAL**2

    @property
    def cost(self) -> dict[str, Floats]:
        """Costs of the results, as stated and, if there are enough of them, by scatter.

        None where a result is 0: that has no relative error, and the scatter of zeros would be none.
        """
        if not all(one.probability > 0.0 for one in self.found):
            return {}
        return {"stated": self.stated} | ({"by scatter": self.scattered} if len(self.found) >= LEAST else {})

    @property
    def best(self) -> float:
        """Cost to compare with: by scatter, if there are enough results, else as stated."""
        costs = list(self.cost.values())
        return float(costs[-1].mean()) if costs else math.inf


def table(found: Mapping[str, Mapping[str, Costs]]) -> list[str]:
    """Return a table with a row for each stack and estimator, that of Monte Carlo computed."""
    lines = [f"| {' | '.join(_HEADS)} |", f"|{'---|' * len(_HEADS)}"]
    for stack, costs in found.items():
        lines += [f"| {' | '.join(entries)} |" for entries in _rows(stack, costs)]
    return lines


def _rows(stack: str, costs: Mapping[str, Costs]) -> Iterator[list[str]]:
    monte_carlo = next(iter(costs.values())).monte_carlo
    better = min([monte_carlo, *(one.best for name, one in costs.items() if name == "ams")])
    truth = f"{next(iter(costs.values())).truth:.2g}"
    yield [stack, truth, "`mc`", "exact", *[""] * 5, f"{monte_carlo:,.0f}", "", ""]
    for name, one in costs.items():
        values = np.array([each.probability for each in one.found]) / one.truth
        size, chosen = len(values), Counter(each.chosen for each in one.found)
        spread = f" ± {values.std(ddof=1) / math.sqrt(size):.3f}" if size > 1 else ""
        means = {kind: float(values.mean()) for kind, values in one.cost.items()}
        costs_told = [f"{means[kind]:,.0f}" if kind in means else "" for kind in _KINDS]
        ratio = f"{one.best / better:.2f}" if means else "no estimate"
        yield [
            stack, truth, f"`{name}`", str(size),
            ", ".join(f"`{each}` {count}" for each, count in sorted(chosen.items())),
            f"{values.mean():.3f}{spread}", str(sum(each.covers for each in one.found)),
            str(sum(bool(each.health) for each in one.found)), str(sum(each.misleads for each in one.found)),
            *costs_told, ratio,
        ]  # fmt: skip
