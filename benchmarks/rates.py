"""Coverage of the interval of a catalogue's rate, and what sharing the budget gains, on synthetic catalogues.

Catalogues are drawn at random: exposures, the hours in which they were counted, and failure probabilities. Of
each, many whole estimates are simulated as ``avrare rate`` makes them: counts of exposures (Poisson), a pilot
that does not count, rollouts by ``divide``'s rule, failures (binomial), the interval. Usage:

    python benchmarks/rates.py [--catalogues 30] [--repetitions 200]
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass

import numpy as np

from avrare.analysis.rates.allocation import allocate
from avrare.analysis.rates.combination import FEW, Quantity, combine, from_count, from_rollouts

PILOT = 0.1
"""Share of the budget that the pilots take."""


@dataclass(frozen=True)
class Regime:
    """Kind of catalogues: scenes, rollouts, ranges of log10 probabilities and of counted exposures."""

    name: str
    scenes: int
    budget: int
    probabilities: tuple[float, float]
    counts: tuple[float, float] | None  # None: exposures are known


REGIMES = (
    Regime("usual", 6, 6000, (-3.0, -0.7), (10, 200)),
    Regime("few exposures", 6, 6000, (-2.0, -0.7), (3, 20)),
    Regime("known exposures", 6, 3000, (-3.0, -1.0), None),
    Regime("thirty scenes", 30, 6000, (-3.0, -1.0), (5, 50)),
    Regime("rare", 6, 2000, (-4.0, -2.0), (10, 100)),
)


@dataclass
class Tally:
    """Outcomes of one catalogue's estimates."""

    covered: int = 0
    low_missed: int = 0
    high_missed: int = 0
    failures: int = 0


def estimate(
    regime: Regime, exposures: np.ndarray, hours: np.ndarray, p: np.ndarray, rng: np.random.Generator
) -> tuple[tuple[float, float], int, list[int]]:
    """Simulate one estimate; return its interval, its failures and the rollouts of each scene."""
    if regime.counts is None:
        known = [Quantity(e, e, e) for e in exposures.tolist()]
    else:
        seen = rng.poisson(exposures * hours)
        known = [from_count(int(c), float(h), 0.95) for c, h in zip(seen, hours, strict=True)]
    pilot = max(int(PILOT * regime.budget / regime.scenes), 10)
    found = [[(int(rng.binomial(pilot, one)), pilot)] for one in p]
    weights = [max(one.value, 1e-9) for one in known]
    rollouts = allocate(weights, found, [1.0] * regime.scenes, regime.budget - pilot * regime.scenes)
    failures = [int(rng.binomial(n, one)) for n, one in zip(rollouts, p, strict=True)]
    few = sum(failures) < FEW
    parts = [from_rollouts(k, n, 0, 0.95, few) for k, n in zip(failures, rollouts, strict=True)]
    return combine(known, parts).interval, sum(failures), rollouts


def simulate(regime: Regime, catalogues: int, repetitions: int) -> None:
    """Print coverage and gain of one regime."""
    rng = np.random.default_rng(1)
    tallies, gains = [], []
    for _ in range(catalogues):
        exposures = 10.0 ** rng.uniform(-1.0, 1.5, regime.scenes)
        low, high = regime.counts or (1.0, 1.0)
        hours = 10.0 ** rng.uniform(np.log10(low), np.log10(high), regime.scenes) / exposures
        p = 10.0 ** rng.uniform(*regime.probabilities, regime.scenes)
        truth, tally, variances = float(exposures @ p), Tally(), []
        for _ in range(repetitions):
            (below, above), failures, rollouts = estimate(regime, exposures, hours, p, rng)
            tally.covered += below <= truth <= above
            tally.low_missed += truth < below
            tally.high_missed += truth > above
            tally.failures += failures
            variances.append(float((exposures**2 * p * (1 - p) / rollouts).sum()))
        equal = float((exposures**2 * p * (1 - p)).sum()) * regime.scenes / regime.budget
        gains.append(equal / np.mean(variances))
        tallies.append(tally)
    shares = np.array([one.covered for one in tallies]) / repetitions
    total = catalogues * repetitions
    missed = [sum(getattr(one, f"{end}_missed") for one in tallies) / total for end in ("low", "high")]
    failures = sum(one.failures for one in tallies) / total
    print(
        f"{regime.name:16s} coverage {shares.mean():.3f} ({shares.min():.3f} .. {shares.max():.3f})"
        f"  truth below {missed[0]:.3f}, above {missed[1]:.3f}  failures {failures:.0f}"
        f"  gain {np.median(gains):.2f} ({np.min(gains):.2f} .. {np.max(gains):.2f})",
        flush=True,
    )


def main() -> None:
    """Simulate every regime."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--catalogues", type=int, default=30)
    parser.add_argument("--repetitions", type=int, default=200)
    args = parser.parse_args()
    for regime in REGIMES:
        simulate(regime, args.catalogues, args.repetitions)


if __name__ == "__main__":
    main()
