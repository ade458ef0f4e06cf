"""Table of estimates of known probabilities: what they cost, beside Monte Carlo at the error they reached."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.studies import kept

_HEADS = (
    "rule", "p", "asked", "how", "results", "chosen", "mean / p", "cover", "warned", "CW", "reached",
    "to learn", "rollouts", "over Monte Carlo's", "by scatter", "gain of rows",
)  # fmt: skip
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
        gain: Exact gain over Monte Carlo of rows that count, on the truth's failures; None in a climb.
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
    gain: float | None
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

    @property
    def over_monte_carlo(self) -> float:
        """Cost over that of Monte Carlo at the relative error that the result states."""
        return self.rollouts * self.relative_error**2 * self.truth / (1.0 - self.truth)


def read(file: Path) -> list[Outcome]:
    """Read the outcomes of a cell, in the order of their seeds; a torn line is left out."""
    found = (Outcome(**{**fields, "health": tuple(fields["health"])}) for fields in kept.lines(file))
    return sorted(found, key=lambda one: one.seed)


def head() -> list[str]:
    """Return the first lines of the table."""
    return [f"| {' | '.join(_HEADS)} |", f"|{'---|' * len(_HEADS)}"]


def row(rule: str, error: float, how: str, found: list[Outcome], wanted: int) -> str:
    """Return the row of a cell."""
    truth, size = found[0].truth, len(found)
    values = np.array([one.probability for one in found]) / truth
    spread = f" ± {values.std(ddof=1) / math.sqrt(size):.3f}" if size > 1 else ""
    cost = float(np.mean([one.rollouts for one in found]))
    ratio = float(np.mean([one.over_monte_carlo for one in found]))
    scatter = float(((values - 1.0) ** 2).mean()) * cost * truth / (1.0 - truth)
    gains = [one.gain for one in found if one.gain is not None]
    chosen = Counter(one.chosen for one in found)
    entries = (
        f"`{rule}`", f"{truth:.2g}", f"{error:.0%}".replace("%", " %"), how, f"{size} of {wanted}",
        ", ".join(f"`{name}` {count}" for name, count in sorted(chosen.items())),
        f"{values.mean():.3f}{spread}", str(sum(one.covers for one in found)),
        str(sum(bool(one.health) for one in found)), str(sum(one.misleads for one in found)),
        f"{np.median([one.relative_error for one in found]):.1%}".replace("%", " %"),
        f"{np.mean([one.learning for one in found]):,.0f}", f"{cost:,.0f}",
        f"{ratio:.2f}" if math.isfinite(ratio) else "none",  # an estimate of 0 states no error
        f"{scatter:.2f}" if size >= LEAST else "", f"{np.mean(gains):.1f}" if gains else "",
    )  # fmt: skip
    return f"| {' | '.join(entries)} |"


def put(page: Path, mark: str, lines: list[str]) -> None:
    """Write lines between the marks of a page."""
    begin, end = f"<!-- {mark} -->\n", f"<!-- end of {mark} -->"
    before, _, rest = page.read_text(encoding="utf-8").partition(begin)
    _, found, after = rest.partition(end)
    if not found:
        raise ValueError(f"{page}: has no lines {begin.strip()} and {end}")
    page.write_text("".join([before, begin, *(f"{line}\n" for line in lines), end, after]), encoding="utf-8")
