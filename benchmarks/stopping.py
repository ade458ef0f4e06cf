"""Coverage and cost of estimates that stop at a relative error, written into docs/statistics/stopping.csv.

    OMP_NUM_THREADS=1 python benchmarks/stopping.py [--estimates 1000]     # about five minutes

The rule of `ams` and `ess` is applied to runs of known mean: to drawn values (log-normal, gamma, a rare large
value), and to a pool of independent runs of the estimators on problems with exact answers. Three kinds of
interval are compared: that of the rule; the same looks at the full confidence each; and a number of runs
fixed beforehand that has the wanted relative error exactly.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import avrare
from avrare.protocols import Floats
from avrare_estimators.common.looks import Looks
from benchmarks.studies.run_intervals import interval_of_runs
from benchmarks.studies.untuned_problems import untuned_problems

TABLE = Path(__file__).parents[1] / "docs" / "statistics" / "stopping.csv"
FIRST, MOST, CONFIDENCE = 10, 320, 0.95
GOALS = (0.2, 0.1)
HEADS = (
    "runs,goal,estimates,mean / truth,standard error,spread,cover,unpaid,"
    "fixed,mean runs,fixed runs,at the cap"
)
RUNS = 1000
"""Runs of an estimator on a problem, from which estimates draw with replacement."""
_CHUNK = 50_000


@dataclass(frozen=True)
class Source:
    """Runs with a known mean.

    Attributes:
        name: What they are.
        mean: Their exact mean.
        draw: Function from a number of estimates to runs enough for them, in one row.
        particles: Number of particles of a run.
    """

    name: str
    mean: float
    draw: Callable[[int], Floats]
    particles: int = 250


@dataclass(frozen=True)
class Stopped:
    """An estimate that has stopped.

    Attributes:
        value: Mean of its runs.
        runs: Number of runs.
        capped: The goal was not reached.
        covers: The interval of the rule holds the truth.
        naive: So does the interval at the full confidence.
    """

    value: float
    runs: int
    capped: bool
    covers: bool
    naive: bool


def main() -> None:
    """Simulate every source at every goal and write the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--estimates", type=int, default=1000, help="in each row (default 1000)")
    estimates = parser.parse_args().estimates
    rows = [HEADS]
    for source in (*drawn(), *estimated()):
        values = source.draw(estimates)
        for goal in GOALS:
            rows.append(row(source, values, goal, estimates))
            print(rows[-1], flush=True)
    TABLE.write_text("".join(f"{line}\n" for line in rows), encoding="utf-8")


def drawn() -> Iterator[Source]:
    """Yield sources of drawn values of mean 1."""
    rng = np.random.default_rng(18)

    def law(name: str, draw: Callable[[int], Floats]) -> Source:
        return Source(name, 1.0, lambda estimates: draw(estimates * MOST))

    for spread in (0.4, 0.8, 1.5):
        width = math.sqrt(math.log1p(spread**2))
        yield law(
            f"log-normal, spread {spread}",
            lambda n, w=width: np.exp(w * rng.standard_normal(n) - w**2 / 2.0),  # type: ignore[misc]
        )
    yield law("gamma, spread 0.8", lambda n: rng.gamma(1 / 0.64, 0.64, n))
    yield law(
        "a tenth is 8 times larger",
        lambda n: np.where(rng.random(n) < 0.1, 4.6, 0.6) * rng.gamma(6.25, 0.16, n),
    )
    yield law("half of the runs are 0", lambda n: np.where(rng.random(n) < 0.5, 0.0, rng.gamma(4, 0.5, n)))


def estimated() -> Iterator[Source]:
    """Yield independent runs of the estimators."""
    for name in ("plain_ou", "plain_walk", "units_100", "regimes_1e-3"):
        found = untuned_problems()[name]
        problem = avrare.Problem(found.system, avrare.stl(found.formula), found.steps, chunk=_CHUNK)
        for estimator, options in (("ams", {"particles": 100, "discard": 10}), ("ess", {"chains": 25})):
            yield runs_of(f"{estimator}, {name}", problem, found.probability, options)


def runs_of(name: str, problem: avrare.Problem, truth: float, options: dict[str, Any]) -> Source:
    """Return the runs of an estimator."""

    def draw(estimates: int) -> Floats:
        batches = [
            avrare.estimate(problem, name.partition(",")[0], seed=seed, runs=500, **options).run_probabilities
            for seed in range(RUNS // 500)
        ]
        pool = np.concatenate(batches)
        return np.random.default_rng(5).choice(pool, estimates * MOST)

    return Source(name, truth, draw, options.get("particles", 250))


def row(source: Source, values: Floats, goal: float, most: int) -> str:
    """Return the line of the table for one source and goal."""
    found: list[Stopped] = []
    left = values
    while len(found) < most and len(left) >= MOST:
        found.append(stop(left, source, goal))
        left = left[found[-1].runs :]
    spread = float(np.std([one.value for one in found])) / source.mean
    fixed, fixed_runs = cover_fixed(values, source, goal, most)
    runs = np.array([one.runs for one in found])
    mean = np.mean([one.value for one in found]) / source.mean
    error = spread / math.sqrt(len(found))
    shares = [np.mean([getattr(one, name) for one in found]) for name in ("covers", "naive", "capped")]
    return (
        f'"{source.name}",{goal:g},{len(found)},{mean:.3f},{error:.3f},{spread:.2f},'
        f"{shares[0]:.3f},{shares[1]:.3f},{fixed:.3f},{runs.mean():.0f},{fixed_runs},{shares[2]:.3f}"
    )


def cover_fixed(values: Floats, source: Source, goal: float, most: int) -> tuple[float, int]:
    """Return the coverage of a number of runs that gives the goal exactly, and that number."""
    runs = max(2, math.ceil((float(values.std()) / source.mean / goal) ** 2))
    groups = values[: len(values) // runs * runs].reshape(-1, runs)[:most]
    ends = [interval_of_runs(group, source.particles)(CONFIDENCE) for group in groups]
    return float(np.mean([low <= source.mean <= high for low, high in ends])), runs


def stop(values: Floats, source: Source, goal: float) -> Stopped:
    """Apply the rule to the first of the runs."""
    looks = Looks.until(goal, FIRST, MOST)
    done = 0

    def error() -> float:
        used = values[:done]
        mean = float(used.mean())
        return float(used.std(ddof=1)) / math.sqrt(done) / mean if mean else math.nan

    while more := looks.missing(done, error):
        done += more
    interval_at = interval_of_runs(values[:done], source.particles)
    ends = looks.interval(done, interval_at)(CONFIDENCE), interval_at(CONFIDENCE)
    covers, naive = (low <= source.mean <= high for low, high in ends)
    return Stopped(float(values[:done].mean()), done, not error() <= goal, covers, naive)


if __name__ == "__main__":
    main()
