"""Coverage of the 95 % interval of independent runs: t delta-log, Cox's, and the two joined.

    python benchmarks/run_intervals.py [--samples 40000] [--ams-runs 400]

The first lines draw runs of mean 1 from known laws. The last ones draw sets of runs of ``ams``, default
options, with replacement from a pool, whose mean counts as the truth. Sets with a run of 0 are left out.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator

import numpy as np
from scipy import stats
from studies.untuned_problems import untuned_problems

import avrare
from avrare.protocols import Floats

RUNS = (5, 10, 20)
Law = Callable[[tuple[int, int]], Floats]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--samples", type=int, default=40_000, help="sets of runs of each line")
    parser.add_argument("--ams-runs", type=int, default=400, help="runs in the pool of a problem; 0: none")
    args = parser.parse_args()
    rng = np.random.default_rng(0)
    print("| law of a run | R | t delta-log | Cox | joined | ratio of the ends |\n|---|---|---|---|---|---|")
    for name, law in [*laws(rng), *splitting(rng, args.ams_runs)]:
        columns = zip(*(study(law((args.samples, runs))) for runs in RUNS), strict=True)
        print(
            f"| {name} | {' / '.join(map(str, RUNS))} |",
            " | ".join(map(" / ".join, columns)),
            "|",
            flush=True,
        )


def study(values: Floats) -> list[str]:
    """Return the coverages of 1 and the median ratios of the ends, for values (samples, runs)."""
    values = values[(values > 0.0).all(axis=1)]
    runs = values.shape[1]
    t, mean, logs = stats.t.ppf(0.975, runs - 1), values.mean(axis=1), np.log(values)
    spread = logs.var(axis=1, ddof=1)
    laws = [
        (np.log(mean), np.log1p(values.var(axis=1, ddof=1) / runs / mean**2)),
        (logs.mean(axis=1) + spread / 2.0, spread / runs + spread**2 / (2.0 * (runs - 1))),
    ]
    ends = [(centre - t * np.sqrt(variance), centre + t * np.sqrt(variance)) for centre, variance in laws]
    (low, high), (cox_low, cox_high) = ends
    ends.append((np.minimum(low, cox_low), np.maximum(high, cox_high)))
    covered = [f"{((a <= 0.0) & (b >= 0.0)).mean():.3f}"[1:] for a, b in ends]
    first, _, both = (f"{np.exp(np.median(b - a)):.2g}" for a, b in ends)
    return [*covered, f"{first} → {both}"]


def laws(rng: np.random.Generator) -> Iterator[tuple[str, Law]]:
    """Yield laws of mean 1."""
    for deviation in (0.5, 1.0):
        yield (
            f"log-normal, deviation {deviation} of the logarithm",
            lambda shape, d=deviation: rng.lognormal(-(d**2) / 2.0, d, shape),
        )
    for deviation in (0.5, 1.0):
        yield (
            f"gamma, relative deviation {deviation}",
            lambda shape, d=deviation: rng.gamma(d**-2, d**2, shape),
        )
    yield "Pareto, exponent 3", lambda shape: (rng.pareto(3.0, shape) + 1.0) * 2.0 / 3.0
    yield (
        "one run in ten is 20 times larger",
        lambda shape: rng.lognormal(-0.045, 0.3, shape) * np.where(rng.random(shape) < 0.1, 20.0, 1.0) / 2.9,
    )


def splitting(rng: np.random.Generator, runs: int) -> Iterator[tuple[str, Law]]:
    """Yield the runs of ``ams`` on problems that it was not tuned on."""
    for name in ("plain_walk", "plain_ou", "regimes_1e-3", "regimes_1e-5") if runs else ():
        pool = avrare.estimate(untuned_problems()[name].problem(), "ams", runs=runs).run_probabilities
        yield f"`ams` on `{name}`", lambda shape, pool=pool: rng.choice(pool / pool.mean(), shape)


if __name__ == "__main__":
    main()
