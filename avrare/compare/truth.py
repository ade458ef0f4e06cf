"""The failure probability that estimates are measured against, and where it comes from."""

from __future__ import annotations

from dataclasses import dataclass

from avrare.errors import UsageError
from avrare.estimation.result import Interval, Result

ENOUGH_FAILURES = 100
"""Failures that make a Monte Carlo estimate worth comparing with: a relative error of 10 %."""


@dataclass(frozen=True)
class Truth:
    """A failure probability in (0, 1).

    Attributes:
        probability: Its value.
        source: "exact", "given", "monte carlo" (a long run of its own) or "pooled monte carlo" (the
            comparison's own repetitions).
        interval: Of an estimated one.
        failures: That it rests on, where it is estimated.
    """

    probability: float
    source: str
    interval: Interval | None = None
    failures: int | None = None

    @property
    def estimated(self) -> bool:
        """Whether it has an error of its own."""
        return self.failures is not None


def parse_truth(text: str) -> Truth | int:
    """A given probability, or the rollouts of the Monte Carlo run that is to find it.

    Args:
        text: ``1.2e-4`` or ``mc=1e6``.

    Raises:
        UsageError: Neither.
    """
    word, equals, amount = text.partition("=")
    try:
        value = float((amount if equals else word).replace("_", ""))
    except ValueError:
        value = -1.0
    if equals and word.strip() == "mc" and 1.0 <= value < 2**40 and value == int(value):
        return int(value)
    if not equals and 0.0 < value < 1.0:
        return Truth(value, "given")
    raise UsageError(
        f"--truth {text}: should be a probability between 0 and 1, or mc=ROLLOUTS",
        "for example --truth 1.2e-4 or --truth mc=1e6",
    )


def from_monte_carlo(result: Result) -> Truth:
    """The truth as a long Monte Carlo run sees it.

    Raises:
        UsageError: It saw no failure, or nothing else.
    """
    if not 0.0 < result.probability < 1.0:
        which = "no" if result.probability == 0.0 else "every"
        raise UsageError(
            f"--truth: {which} rollout of {result.rollouts} failed, which tells no probability",
            "give more rollouts, or leave --truth out",
        )
    return Truth(result.probability, "monte carlo", result.interval, result.failures.count)
