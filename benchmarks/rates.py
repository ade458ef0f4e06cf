"""Coverage of the interval of a catalogue's rate, and what sharing the budget gains, on synthetic catalogues.

Catalogues are drawn at random: exposures, the hours in which they were counted, and failure probabilities. Of
each, many whole estimates are simulated as ``avrare rate`` makes them: counts of exposures (Poisson), a pilot
that does not count, rollouts by ``divide``'s rule, failures (binomial), the interval.

In the kinds with rare scenes, these have estimators of their own, and failure probabilities that are known
exactly: splitting whose runs follow the law of ideal splitting, or weighted failures. Usage:

    python benchmarks/rates.py [--catalogues 30] [--repetitions 200] [--only NAME]
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass

import numpy as np

from avrare.analysis.rates.allocation import allocate
from avrare.analysis.rates.combination import FEW, Quantity, combine, from_count, from_rollouts
from avrare.estimation.result.intervals import clopper_pearson, cox, log_normal

PILOT = 0.1
"""Share of the budget that the pilots take."""


@dataclass(frozen=True)
class Splitting:
    """Estimator of rare scenes: independent runs of splitting that knows the best score.

    Survivors of a level are then independent, and minus the logarithm of a level's probability rises by the
    K-th least of N exponential numbers (Guyader, Hengartner and Matzner-Lober 2011, for K = 1).
    """

    runs: int = 10
    particles: int = 100
    discard: int = 10

    def estimate(self, p: float, rng: np.random.Generator) -> Quantity:
        """Return an estimate of ``p`` with the interval of ``ams``."""
        values = np.array([self._run(-np.log(p), rng) for _ in range(self.runs)])
        mean = float(values.mean())
        if mean == 0.0:
            return Quantity(0.0, *clopper_pearson(0, self.runs * self.particles, 0.95))
        spread = float(values.var(ddof=1)) / self.runs / mean**2
        interval = log_normal(mean, spread, 0.95, freedom=self.runs - 1, logs=cox(values))
        return Quantity(mean, *interval)

    def _run(self, depth: float, rng: np.random.Generator) -> float:
        left = self.particles - np.arange(self.discard)
        stages = 4 * int(np.ceil(depth * self.particles / self.discard)) + 20
        gaps = rng.exponential(size=(stages, self.discard)) / left
        begins = np.concatenate([[0.0], np.cumsum(gaps.sum(axis=1))])
        last = int(np.searchsorted(begins, depth, side="right")) - 1  # the K-th is a failure from here on
        assert last < stages
        passed = int((begins[last] + np.cumsum(gaps[last]) <= depth).sum())
        return float((1.0 - self.discard / self.particles) ** last * (1.0 - passed / self.particles))


@dataclass(frozen=True)
class Weighted:
    """Estimator of rare scenes: failures from a proposal, with log-normal weights."""

    rollouts: int = 5000
    share: float = 0.3
    spread: float = 1.0

    def estimate(self, p: float, rng: np.random.Generator) -> Quantity:
        """Return an estimate of ``p`` with the interval of ``is``."""
        hits = int(rng.binomial(self.rollouts, self.share))
        weights = np.exp(rng.normal(-(self.spread**2) / 2.0, self.spread, hits)) * p / self.share
        mean = float(weights.sum()) / self.rollouts
        square = float((weights**2).sum()) / self.rollouts
        variance = (square - mean**2) / (self.rollouts * mean**2)
        return Quantity(mean, *log_normal(mean, variance, 0.95, freedom=0))


@dataclass(frozen=True)
class Regime:
    """Kind of catalogues: scenes, rollouts, ranges of log10 probabilities and of counted exposures.

    The first ``rare`` scenes have p from 1e-7 to 1e-4, the estimator ``own``, and exposures with which they
    are a tenth to ten times as much of the rate as all others together.
    """

    name: str
    scenes: int
    budget: int
    probabilities: tuple[float, float]
    counts: tuple[float, float] | None  # None: exposures are known
    rare: int = 0
    own: Splitting | Weighted = Splitting()


REGIMES = (
    Regime("usual", 6, 6000, (-3.0, -0.7), (10, 200)),
    Regime("few exposures", 6, 6000, (-2.0, -0.7), (3, 20)),
    Regime("known exposures", 6, 3000, (-3.0, -1.0), None),
    Regime("thirty scenes", 30, 6000, (-3.0, -1.0), (5, 50)),
    Regime("rare", 6, 2000, (-4.0, -2.0), (10, 100)),
    Regime("rare scene", 6, 6000, (-3.0, -0.7), (10, 200), 1),
    Regime("known, rare", 6, 6000, (-3.0, -0.7), None, 1),
    Regime("coarse, rare", 6, 6000, (-3.0, -0.7), (10, 200), 1, Splitting(5, 50, 5)),
    Regime("learned, rare", 6, 6000, (-3.0, -0.7), (10, 200), 1, Weighted()),
    Regime("three rare", 6, 6000, (-3.0, -0.7), (10, 200), 3),
    Regime("all rare", 4, 0, (-3.0, -0.7), (10, 200), 4),
)


@dataclass
class Tally:
    """Outcomes of one catalogue's estimates."""

    covered: int = 0
    low_missed: int = 0
    high_missed: int = 0
    failures: int = 0


@dataclass(frozen=True)
class Truth:
    """Catalogue that is known exactly: exposures, hours of counting and probabilities of its scenes."""

    exposures: np.ndarray
    hours: np.ndarray
    p: np.ndarray

    @staticmethod
    def draw(regime: Regime, rng: np.random.Generator) -> Truth:
        """Draw a catalogue of a kind."""
        exposures = 10.0 ** rng.uniform(-1.0, 1.5, regime.scenes)
        low, high = regime.counts or (1.0, 1.0)
        hours = 10.0 ** rng.uniform(np.log10(low), np.log10(high), regime.scenes) / exposures
        p = 10.0 ** rng.uniform(*regime.probabilities, regime.scenes)
        if regime.rare:
            rare = np.arange(regime.scenes) < regime.rare
            rest = float(exposures[~rare] @ p[~rare]) or 1.0
            p[rare] = 10.0 ** rng.uniform(-7.0, -4.0, regime.rare)
            counted = exposures * hours
            exposures[rare] = 10.0 ** rng.uniform(-1.0, 1.0, regime.rare) * rest / p[rare] / regime.rare
            hours = counted / exposures
        return Truth(exposures, hours, p)

    @property
    def rate(self) -> float:
        """Sum of exposure times probability."""
        return float(self.exposures @ self.p)


def estimate(
    regime: Regime, truth: Truth, rng: np.random.Generator
) -> tuple[tuple[float, float], int, list[int]]:
    """Simulate one estimate; return its interval, its failures and the shared rollouts of each scene."""
    if regime.counts is None:
        known = [Quantity(e, e, e) for e in truth.exposures.tolist()]
    else:
        seen = rng.poisson(truth.exposures * truth.hours)
        known = [from_count(int(c), float(h), 0.95) for c, h in zip(seen, truth.hours, strict=True)]
    rare, scenes = regime.rare, regime.scenes - regime.rare
    own = [regime.own.estimate(float(one), rng) for one in truth.p[:rare]]
    if not scenes:
        return combine(known, own).interval, 0, []
    pilot = max(int(PILOT * regime.budget / scenes), 10)
    found = [[(int(rng.binomial(pilot, one)), pilot)] for one in truth.p[rare:]]
    weights = [max(one.value, 1e-9) for one in known]
    others = sum(e * one.value for e, one in zip(weights, own, strict=False))
    rollouts = allocate(weights[rare:], found, [1.0] * scenes, regime.budget - pilot * scenes, [others])
    failures = [int(rng.binomial(n, one)) for n, one in zip(rollouts, truth.p[rare:], strict=True)]
    few = sum(failures) < FEW
    parts = [from_rollouts(k, n, 0, 0.95, few) for k, n in zip(failures, rollouts, strict=True)]
    return combine(known, [*own, *parts]).interval, sum(failures), rollouts


@dataclass(frozen=True)
class Study:
    """Outcome of many estimates of each catalogue of a kind.

    Attributes:
        shares: Coverage of each catalogue.
        low_missed: Share of all estimates whose interval lies above the truth.
        high_missed: Share of those whose interval lies below it.
        failures: Mean failures of an estimate.
        gains: Of each catalogue, variance of equal shares over that of the divided budget.
    """

    shares: np.ndarray
    low_missed: float
    high_missed: float
    failures: float
    gains: list[float]


def study(regime: Regime, catalogues: int, repetitions: int) -> Study:
    """Simulate one kind of catalogues."""
    rng = np.random.default_rng(1)
    tallies, gains = [], []
    for _ in range(catalogues):
        truth, tally, variances = Truth.draw(regime, rng), Tally(), []
        e, p = truth.exposures[regime.rare :], truth.p[regime.rare :]
        for _ in range(repetitions):
            (below, above), failures, rollouts = estimate(regime, truth, rng)
            tally.covered += below <= truth.rate <= above
            tally.low_missed += truth.rate < below
            tally.high_missed += truth.rate > above
            tally.failures += failures
            if rollouts:
                variances.append(float((e**2 * p * (1 - p) / rollouts).sum()))
        if variances:
            equal = float((e**2 * p * (1 - p)).sum()) * len(p) / regime.budget
            gains.append(equal / float(np.mean(variances)))
        tallies.append(tally)
    total = catalogues * repetitions
    return Study(
        np.array([one.covered for one in tallies]) / repetitions,
        sum(one.low_missed for one in tallies) / total,
        sum(one.high_missed for one in tallies) / total,
        sum(one.failures for one in tallies) / total,
        gains,
    )


def simulate(regime: Regime, catalogues: int, repetitions: int) -> None:
    """Print coverage and gain of one kind of catalogues."""
    found = study(regime, catalogues, repetitions)
    shares, gains = found.shares, found.gains
    gain = f"{np.median(gains):.2f} ({np.min(gains):.2f} .. {np.max(gains):.2f})" if gains else "none"
    print(
        f"{regime.name:16s} coverage {shares.mean():.3f} ({shares.min():.3f} .. {shares.max():.3f})"
        f"  truth below {found.low_missed:.3f}, above {found.high_missed:.3f}"
        f"  failures {found.failures:.0f}  gain {gain}",
        flush=True,
    )


def main() -> None:
    """Simulate every regime."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--catalogues", type=int, default=30)
    parser.add_argument("--repetitions", type=int, default=200)
    parser.add_argument("--only", choices=[one.name for one in REGIMES], help="one kind")
    args = parser.parse_args()
    for regime in [one for one in REGIMES if args.only in (None, one.name)]:
        simulate(regime, args.catalogues, args.repetitions)


if __name__ == "__main__":
    main()
