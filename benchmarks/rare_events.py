"""Learned proposals on the noise tape: cost, bias and trust on problems with exact answers, and a drive.

    OMP_NUM_THREADS=1 python -m benchmarks.rare_events [--cases NAME,...] [--seeds 20] [--first 0]
        [--set relative_error=0.1 ...]

A case is an id of ``avrare.testing``, a problem of ``studies/untuned_problems.py``, one of ``OWN`` below, or
SCENARIO:SPECIFICATION (`lane_change:no_collision`, with the riccati backend; without a truth, its relative
variance is estimated by the results themselves). Cost is in rollouts and counts pilot, stages and check.
CW: no warning, and the interval misses the truth by more than a factor 3.
"""

from __future__ import annotations

import argparse
import ast
import math
import time
import warnings
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import chi2, norm

import avrare
from avrare import Problem, stl
from avrare.protocols import Floats
from avrare.testing.problems import reference_problem, reference_problems
from benchmarks.studies.untuned_problems import untuned_names, untuned_problem

GOALS = {"d_rw_L3.8": 60, "d_rw_L4.8": 150, "e_ou_L4.0": 80, "e_ou_L5.0": 600}
"""Relative mean squared error times cost to stay below."""
ROOT = Path(__file__).parents[1]


@dataclass(frozen=True)
class Peaks:
    """State: largest noise so far of some channels.

    Attributes:
        largest: (N, K) largest magnitudes of the first K channels.
        energy: (N,) sum of squares of all noise.
    """

    largest: Floats
    energy: Floats


class Outliers:
    """System that remembers outliers of its noise: it fails by two at once, or by the sum of all squares."""

    noise_size = 6

    def initial(self, noise: Floats) -> Peaks:
        """Begin without a memory; the noise of the start counts for nothing."""
        return Peaks(np.zeros((len(noise), 2)), np.zeros(len(noise)))

    def step(self, state: Peaks, noise: Floats) -> Peaks:
        """Remember the largest noise of two channels, and add up the squares."""
        largest = np.maximum(state.largest, np.abs(noise[:, :2]))
        return Peaks(largest, state.energy + (noise * noise).sum(axis=1))

    def signals(self, state: Peaks) -> dict[str, Floats]:
        """Return ``both``, the smaller of two peaks, ``one``, the first, and ``energy``."""
        return {"both": state.largest.min(axis=1), "one": state.largest[:, 0], "energy": state.energy}


def _outliers(formula: str, probability: float) -> tuple[Problem, float]:
    return Problem(Outliers(), stl(formula), _STEPS), probability


_STEPS = 20


def _peak(level: float) -> float:
    return float(-np.expm1(_STEPS * np.log1p(-2.0 * norm.sf(level))))


OWN: dict[str, Callable[[], tuple[Problem, float]]] = {
    "one_outlier": lambda: _outliers("always (one < 4.4)", _peak(4.4)),
    "two_outliers": lambda: _outliers("always (both < 3.6)", _peak(3.6) ** 2),
    "no_structure": lambda: _outliers("always (energy < 180)", float(chi2.sf(180.0, 6 * _STEPS))),
}
"""Failures by one outlier, by two of different channels at any two steps, and by no noise in particular."""


def find_case(name: str) -> tuple[Problem, float | None]:
    """Return the problem of a case and its exact probability."""
    if ":" in name:
        scenario, specification = name.split(":")
        loaded = avrare.load(ROOT / "scenarios" / f"{scenario}.yaml", ["controller.backend=riccati"])
        return loaded.problem(specification), None
    if name in OWN:
        return OWN[name]()
    if name in untuned_names():
        untuned = untuned_problem(name)
        return untuned.problem(), untuned.probability
    exact = reference_problem(name)
    return exact.problem(), exact.probability


def measure(name: str, seeds: range, options: dict[str, Any]) -> str:
    """Return the row of a case."""
    problem, truth = find_case(name)
    began = time.process_time()
    results = [avrare.estimate(problem, "is", seed=seed, **options) for seed in seeds]
    seconds = (time.process_time() - began) / len(results)
    values = np.array([result.probability for result in results])
    p = truth if truth is not None else float(values.mean())
    cost = np.array([result.rollouts for result in results], dtype=float)
    low, high = np.array([result.interval for result in results]).T / p
    quiet = np.array([not result.health for result in results])
    covers, far = (low <= 1.0) & (high >= 1.0), (low > 3.0) | (high < 1.0 / 3.0)
    error = values.std(ddof=1) / p / math.sqrt(len(values)) if len(values) > 1 else math.nan
    if truth is not None:
        gained = float(((values / p - 1.0) ** 2).mean() * cost.mean())
    else:
        gained = float(np.mean([result.relative_error**2 * result.rollouts for result in results]))
    pilot = np.mean([result.diagnostics["pilot_rollouts"] for result in results])
    names = Counter(warning for result in results for warning in result.health)
    entries = [
        name, f"{p:.3g}", str(len(results)), f"{values.mean() / p:.3f} ± {error:.3f}", f"{gained:.1f}",
        str(GOALS.get(name, "")), f"{(1.0 - p) / p:,.0f}", _share(covers), _share(~quiet),
        _share(covers[quiet]), _share(far & quiet), f"{np.median(high / np.maximum(low, 1e-12)):.2f}",
        f"{cost.mean():,.0f}", f"{pilot:,.0f}", f"{seconds:.1f}",
        ", ".join(f"{name} {count}" for name, count in names.items()),
    ]  # fmt: skip
    return f"| {' | '.join(entries)} |"


def _share(hits: Any) -> str:
    return f"{np.mean(hits):.3f}" if len(hits) else ""


def main() -> None:
    """Print one row per case."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--cases", default=",".join([*GOALS, *OWN]))
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--set", action="append", default=[], metavar="OPTION=VALUE")
    given = parser.parse_args()
    options = {key: ast.literal_eval(value) for key, value in (one.split("=", 1) for one in given.set)}
    groups = {"untuned": untuned_names(), "exact": tuple(one.id for one in reference_problems())}
    heads = (
        "case", "p", "results", "mean / p", "relMSE x cost", "goal", "Monte Carlo's", "covers", "warned",
        "covers unwarned", "CW", "ends' ratio", "rollouts", "of them to learn", "seconds", "warnings",
    )  # fmt: skip
    print(f"| {' | '.join(heads)} |\n|{'---|' * len(heads)}")
    warnings.simplefilter("ignore", avrare.HealthWarning)
    for case in (one for name in given.cases.split(",") for one in groups.get(name, (name,))):
        print(measure(case, range(given.first, given.first + given.seeds), options), flush=True)


if __name__ == "__main__":
    main()
