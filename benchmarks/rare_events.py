"""Learned proposals on the noise tape: cost, bias and trust on problems with exact answers, and a drive.

    OMP_NUM_THREADS=1 python -m benchmarks.rare_events [--cases NAME,...] [--seeds 20] [--first 0]
        [--estimator auto] [--set relative_error=0.1 ...] [--out FILE]

A case is an id of ``avrare.testing``, a problem of ``studies/untuned_problems.py``, one of ``OWN`` below, or
SCENARIO:SPECIFICATION of a scenario with a truth in docs/ground-truth (`lane_change:no_collision`), or
SCENARIO:SPECIFICATION@P at the robustness that so small a share of its rollouts falls to
(`lane_change:no_collision@1e-4`), or, without a truth, SCENARIO:SPECIFICATION=P with a probability known
otherwise. SCENARIO is a name in scenarios/ or the path of a YAML file; `benchmarks/ground_truth.py` makes its
truth. Cost is in steps over those of a rollout, and counts pilot, stages and check.
With ``--out`` a study that was stopped goes on where it was.
"stated" is cost times the square of the relative error that results state themselves; nan where one states
none.
CW: no warning, and the interval misses the truth by more than a factor 3.
"""

from __future__ import annotations

import argparse
import ast
import json
import math
import time
import warnings
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import chi2, norm

import avrare
from avrare import Problem, stl
from avrare.protocols import Floats
from avrare.testing.faulty_systems import Scrambled
from avrare.testing.problems import reference_problem, reference_problems
from benchmarks.studies.levels import read_case
from benchmarks.studies.untuned_problems import untuned_names, untuned_problem

GOALS = {"d_rw_L3.8": 60, "d_rw_L4.8": 150, "e_ou_L4.0": 80, "e_ou_L5.0": 600}
"""Relative mean squared error times cost to stay below."""
_KEYS = ("case", "seed", "estimator", "options")


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


def _scrambled(probability: float) -> tuple[Problem, float]:
    return Problem(Scrambled(_STEPS), stl(f"always (x > {probability})"), _STEPS), probability


OWN: dict[str, Callable[[], tuple[Problem, float]]] = {
    "one_outlier": lambda: _outliers("always (one < 4.4)", _peak(4.4)),
    "two_outliers": lambda: _outliers("always (both < 3.6)", _peak(3.6) ** 2),
    "scrambled_1e-2": lambda: _scrambled(1e-2),
    "scrambled_1e-3": lambda: _scrambled(1e-3),
    "scrambled_1e-4": lambda: _scrambled(1e-4),
    "no_structure": lambda: _outliers("always (energy < 180)", float(chi2.sf(180.0, 6 * _STEPS))),
}
"""Failures by one outlier, by two of different channels at any two steps, and by no noise in particular."""


def find_case(name: str) -> tuple[Problem, float]:
    """Return the problem of a case and its exact probability."""
    if ":" in name:
        return read_case(name)
    if name in OWN:
        return OWN[name]()
    if name in untuned_names():
        untuned = untuned_problem(name)
        return untuned.problem(), untuned.probability
    exact = reference_problem(name)
    return exact.problem(), exact.probability


def estimate(name: str, seed: int, estimator: str, options: dict[str, Any]) -> dict[str, Any]:
    """Return what one estimate of a case found, as plain data."""
    problem, truth = find_case(name)
    began = time.process_time()
    result = avrare.estimate(problem, estimator, seed=seed, **options)
    # Of splitting and of particles a rollout may be the rest of another.
    cost = result.simulated_steps / problem.steps if problem.steps else result.rollouts
    tried = sum(one["rollouts"] for one in result.diagnostics.get("choice", {"tried": []})["tried"])
    return {
        "case": name, "seed": seed, "estimator": estimator, "options": options, "truth": truth,
        "chosen": " ".join([result.estimator, *_score(result)]),
        "probability": result.probability, "interval": list(result.interval),
        "relative_error": result.relative_error, "rollouts": cost, "health": list(result.health),
        "pilot": sum(result.diagnostics.get(f"{name}_rollouts", 0) for name in ("pilot", "learning")) + tried,
        "seconds": time.process_time() - began,
    }  # fmt: skip


def _score(result: avrare.Result) -> list[str]:
    """Return the score that splitting used, where it could have learned one."""
    return [f"({result.diagnostics['score']['used']})"] if "score" in result.diagnostics else []


def summarise(name: str, found: Sequence[dict[str, Any]], goal: float | None) -> str:
    """Return the row of a case; with a goal the cost is compared with that of ``mc``, (2 + 1/goal^2) / p."""
    values = np.array([one["probability"] for one in found])
    p = found[0]["truth"]
    cost = np.array([one["rollouts"] for one in found], dtype=float)
    low, high = np.array([one["interval"] for one in found]).T / p
    quiet = np.array([not one["health"] for one in found])
    covers, far = (low <= 1.0) & (high >= 1.0), (low > 3.0) | (high < 1.0 / 3.0)
    error = values.std(ddof=1) / p / math.sqrt(len(values)) if len(values) > 1 else math.nan
    gained = float(((values / p - 1.0) ** 2).mean() * cost.mean())
    stated = np.array([one["relative_error"] or math.nan for one in found]) ** 2
    names = Counter(warning for one in found for warning in one["health"])
    chosen = Counter(one["chosen"] for one in found)
    entries = [
        name, f"{p:.3g}", str(len(found)), _words(chosen), f"{values.mean() / p:.3f} ± {error:.3f}",
        f"{gained:.1f}", f"{stated.mean() * cost.mean():.1f}", str(GOALS.get(name, "")),
        f"{(1.0 - p) / p:,.0f}", _share(covers), _share(~quiet),
        _share(covers[quiet]), _share(far & quiet), f"{np.median(high / np.maximum(low, 1e-12)):.2f}",
        f"{cost.mean():,.0f}", f"{cost.mean() * p / (goal**-2 + 2.0):.2f}" if goal else "",
        f"{np.mean([one['pilot'] for one in found]):,.0f}",
        f"{np.mean([one['seconds'] for one in found]):.1f}", _words(names),
    ]  # fmt: skip
    return f"| {' | '.join(entries)} |"


def _words(counts: Counter[str]) -> str:
    return ", ".join(f"{name} {count}" for name, count in counts.items())


def _share(hits: Any) -> str:
    return f"{np.mean(hits):.3f}" if len(hits) else ""


def main() -> None:
    """Print one row per case."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--cases", default=",".join([*GOALS, *OWN]))
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--estimator", default="is", help="is, auto, smc or ams")
    parser.add_argument("--set", action="append", default=[], metavar="OPTION=VALUE")
    parser.add_argument(
        "--out", type=Path, help="file of lines to which results go; those in it are not made again"
    )
    given = parser.parse_args()
    options = {key: ast.literal_eval(value) for key, value in (one.split("=", 1) for one in given.set)}
    groups = {"untuned": untuned_names(), "exact": tuple(one.id for one in reference_problems())}
    heads = (
        "case", "p", "results", "chosen", "mean / p", "relMSE x cost", "stated", "goal", "Monte Carlo's",
        "covers", "warned", "covers unwarned", "CW", "ends' ratio", "rollouts", "over mc's",
        "of them to learn", "seconds", "warnings",
    )  # fmt: skip
    print(f"| {' | '.join(heads)} |\n|{'---|' * len(heads)}")
    warnings.simplefilter("ignore", avrare.HealthWarning)
    kept = (
        [json.loads(line) for line in given.out.read_text().splitlines()]
        if given.out and given.out.exists()
        else []
    )
    known = {json.dumps([one[key] for key in _KEYS]): one for one in kept}
    goal = options.get("relative_error", None if options or given.estimator != "auto" else 0.2)
    for case in (one for name in given.cases.split(",") for one in groups.get(name, (name,))):
        found = []
        for seed in range(given.first, given.first + given.seeds):
            key = json.dumps([case, seed, given.estimator, options])
            if key not in known:
                known[key] = estimate(case, seed, given.estimator, options)
                if given.out:
                    with given.out.open("a") as lines:
                        print(json.dumps(known[key]), file=lines, flush=True)
            found.append(known[key])
        print(summarise(case, found, goal), flush=True)


if __name__ == "__main__":
    main()
