"""Proof that a change lowers a failure probability: start and result, on noise that chose neither."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from avrare.analysis.compare.paired_comparison import compare_pairs
from avrare.analysis.compare.version_changes import PairedCounts
from avrare.base.number_format import format_interval, format_probability, format_signed_interval
from avrare.estimation.result import intervals
from avrare.estimation.result.intervals import Interval
from avrare.rollout.executors.work import Executor
from avrare.rollout.loaded_scenario import LoadedScenario

ENOUGH = 10
"""Failures that a paired comparison should expect at the start; fewer say too little."""


@dataclass(frozen=True)
class Side:
    """One side of the comparison: probability and interval."""

    probability: float
    interval: Interval

    def line(self, name: str) -> str:
        """Return a one-line description."""
        return f"  {name:<7}{format_probability(self.probability)}   {format_interval(self.interval)}"


@dataclass(frozen=True)
class Proof:
    """Comparison of start and result.

    Attributes:
        before: The start.
        after: The result.
        counts: Paired counts of all specifications, that of the search first; none for two estimates.
        confidence: Level at which ``moved`` holds.
        maximise: The probability was to rise.
    """

    before: Side
    after: Side
    counts: tuple[PairedCounts, ...]
    confidence: float
    maximise: bool = False

    @property
    def moved(self) -> bool:
        """True if the change of the probability in the right direction is proved."""
        if self.counts:
            return self.counts[0].verdict(self.confidence) == ("worse" if self.maximise else "better")
        low, high = (self.before, self.after) if self.maximise else (self.after, self.before)
        return low.interval[1] < high.interval[0]

    @property
    def harmed(self) -> tuple[PairedCounts, ...]:
        """The other specifications that are shown to fail more often."""
        return tuple(counts for counts in self.counts[1:] if counts.verdict(self.confidence) == "worse")

    def lines(self) -> list[str]:
        """Return a one-line description."""
        return [*self._head(), self.before.line("before"), self.after.line("after"), *self._verdict()]

    def _head(self) -> list[str]:
        if self.counts:
            counts = self.counts[0]
            broken = f", {counts.errors} broke down" if counts.errors else ""
            return [f"the same {counts.count + counts.errors:,} fresh tapes before and after{broken}:"]
        return [f"fresh estimates, at {self.confidence:.1%} together:"]

    def _verdict(self) -> list[str]:
        word, opposite = ("rose", "fell") if self.maximise else ("fell", "rose")
        if not self.counts:
            said = f"it {word}: the intervals do not meet" if self.moved else "not shown: the intervals meet"
            return [f"  {said}"]
        counts = self.counts[0]
        change = (
            f"{format_signed_interval(counts.interval(self.confidence))} (Tango), "
            f"McNemar p = {counts.p_value:.2g}"
        )
        said = f"it {word}" if self.moved else "not shown"
        if counts.verdict(self.confidence) == ("better" if self.maximise else "worse"):
            said = f"it {opposite}"
        lines = [f"  {said}: {counts.only_first} fail only before, {counts.only_second} only after; {change}"]
        return lines + [
            f"  but {other.specification} fails more often: {other.first:.3g}, then {other.second:.3g}"
            for other in self.harmed
        ]


def prove_by_pairs(
    before: LoadedScenario,
    after: LoadedScenario,
    specification: str,
    rollouts: int,
    seed: int,
    executor: Executor,
    maximise: bool = False,
) -> Proof:
    """Run both scenarios on the same fresh tapes, and count the outcomes of every specification."""
    names = (specification, *(name for name in before.specifications if name != specification))
    confidence = before.definition.confidence
    counts = tuple(compare_pairs(before.problem(names), after.problem(names), rollouts, seed, executor))
    first = counts[0]

    def side(only: int) -> Side:
        failed, total = first.both + only, first.count + first.errors
        return Side(
            failed / max(first.count, 1), intervals.clopper_pearson(failed, total, confidence, first.errors)
        )

    return Proof(side(first.only_first), side(first.only_second), counts, confidence, maximise)


def prove_by_estimates(
    before: LoadedScenario,
    after: LoadedScenario,
    confidence: float,
    estimate: Callable[[LoadedScenario, int, float], Side],
    maximise: bool = False,
) -> Proof:
    """Estimate both on independent noise, each at a level at which both intervals hold together.

    Args:
        before: The start.
        after: The result.
        confidence: Level of both together.
        estimate: Function from a scenario, its number (0, 1) and a level to the estimate.
        maximise: The probability was to rise.
    """
    level = 1.0 - (1.0 - confidence) / 2.0
    sides = [estimate(version, number, level) for number, version in enumerate((before, after))]
    return Proof(sides[0], sides[1], (), confidence, maximise)
