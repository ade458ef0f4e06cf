"""Error rates of the gate: false alarms on an unchanged system, doublings that it catches, slow drift.

    python benchmarks/gate.py [--checks 400] [--pool 200] [--only ams] [--folder benchmarks/results/gate]

Each check draws a baseline and a new estimate of a system whose failure probability is known, both afresh,
and compares them as ``avrare check`` does with its default tolerance. A baseline with warnings is drawn
again, as the gate does not save it by itself; where 50 draws have warnings, the first stands, as one saved by
hand. "unchanged" should fail in at most 2.5 % of the checks. "at the bound" is the threshold ``< p`` at
exactly p: at most 2.5 % may fail and 2.5 % pass, also after several looks. An estimate of splitting or slices
is a set of runs from a pool that is simulated once and kept in ``--folder``, in parts, so that an interrupted
study goes on; the mean of the pool counts as the truth.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from studies.run_intervals import interval_of_runs
from studies.untuned_problems import Regimes, untuned_problem

import avrare
from avrare.analysis.check.criteria import Criterion, decide_criteria
from avrare.analysis.check.pooling import SHARES, pool
from avrare.base.special_functions import bisect
from avrare.estimation.result import intervals
from avrare.estimation.result.result import Result
from avrare.protocols import Floats
from avrare.rollout.problem import Problem
from avrare.scenario.schema import Regression, Threshold
from avrare.testing.problems import linear, walk
from avrare_estimators.common import health

Draw = Callable[[float, int], Result]
"""(factor on the probability, share of the budget in eighths) -> an estimate."""
_PART = 25
"""Runs of a part of a pool."""
_SIZES: dict[tuple[str, str], dict[str, int]] = {
    ("ams", "walk"): {"particles": 400, "discard": 40},
    ("ams", "hidden regimes"): {"particles": 250, "discard": 25},
    ("ams", "rare regimes"): {"particles": 300, "discard": 30},
    ("ess", "walk"): {"chains": 100},
    ("ess", "hidden regimes"): {"chains": 150},
}
"""Sizes of a run, fixed so that all runs of a pool are alike; those of rare regimes have too few roots."""
_DRAWS = 50
"""Draws of a baseline, of which the first without warnings is taken."""


@dataclass(frozen=True)
class Case:
    """An estimator with its budget, on one problem."""

    probability: float
    draw: Draw
    doubled: float = 2.0  # probability of the doubled system over that of the first


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--checks", type=int, default=400, help="of each kind (default 400)")
    parser.add_argument("--pool", type=int, default=200, help="runs in a pool (default 200)")
    parser.add_argument("--folder", type=Path, default=Path("benchmarks/results/gate"), help="of the pools")
    parser.add_argument("--only", default="", help="part of a title: mc, ams, ess, walk, hidden, drift, ...")
    args = parser.parse_args()
    print("| estimate | system | fails | passes | inconclusive | warned |\n|---|---|---|---|---|---|")
    for title, case in cases(args.pool, args.folder):
        if args.only in title:
            study(title, case(), args.checks)
    for first in (False, True) if args.only in "drift" else ():
        rng = np.random.default_rng(0)
        reached = [drift(rng, first) for _ in range(args.checks // 10)]
        ends = ", ".join(f"{end:.2f}" for end in np.quantile(reached, (0.5, 0.9)))
        which = "newest and first baseline" if first else "newest baseline only"
        print(f"+10 % a step, {which}: fails at {ends} times the first (median, 90 %)", flush=True)


def study(title: str, case: Case, checks: int) -> None:
    """Print the lines of one case."""
    baselines = [draw_baseline(case) for _ in range(checks)]
    lean = float(np.mean([entry.probability for entry in baselines])) / case.probability
    warned = sum(bool(entry.health) for entry in baselines) / checks
    unchanged = [compare(case, entry, 1.0) for entry in baselines]
    report(title, f"unchanged (baselines: mean {lean:.2f} p, {warned:.0%} warned)", unchanged)
    report(title, f"{case.doubled:.2f} p", [compare(case, entry, 2.0) for entry in baselines[::2]])
    for text, looks in (("one look", (8,)), ("up to four looks", tuple(int(8 * share) for share in SHARES))):
        report(title, f"at the bound, {text}", [at_bound(case, looks) for _ in range(checks)])


def report(name: str, system: str, verdicts: list[tuple[str, bool]]) -> None:
    """Print one line."""
    found = Counter(verdict for verdict, _ in verdicts)
    warned = sum(warned for _, warned in verdicts)
    counts = (found["fail"], found["pass"], found["inconclusive"], warned)
    print(
        f"| {name} | {system} |",
        " | ".join(f"{count / len(verdicts):.1%}" for count in counts),
        "|",
        flush=True,
    )


def cases(runs: int, folder: Path) -> Iterator[tuple[str, Callable[[], Case]]]:
    """Yield Monte Carlo with about 40, 4 and 0 failures in the baseline, splitting and slices, by title."""
    for p in (0.01, 0.001, 1e-4):
        draw = partial(monte_carlo, np.random.default_rng(0), p, 500)
        yield f"mc, p = {p:g}, 4,000 rollouts", partial(Case, p, draw)
    for name, problem in _SIZES:
        yield f"{name}, {problem}, 16 runs", partial(case_of_pools, name, problem, runs, folder)


def case_of_pools(name: str, problem: str, runs: int, folder: Path) -> Case:
    """Return the case of an estimator with runs, once they are simulated."""
    sizes, systems = _SIZES[name, problem], _SYSTEMS[problem]()
    stem = folder / f"{name}_{problem.replace(' ', '_')}"
    pools = {
        factor: pool_of(stem.with_name(f"{stem.name}_{factor:g}"), one, runs, name, **sizes)
        for factor, one in systems.items()
    }
    mean, doubled = (float(pools[factor][0].mean()) for factor in (1.0, 2.0))
    return Case(mean, partial(runs_of, np.random.default_rng(0), pools), doubled / mean)


def walks() -> dict[float, Problem]:
    """Return a random walk of 8 steps, with p = 0.001 and 0.002."""
    levels = {1.0: 0.8879303823027385, 2.0: 0.830314331268937}
    return {factor: walk(level, steps=8).problem(chunk=5000) for factor, level in levels.items()}


def regimes(p: float) -> dict[float, Problem]:
    """Return a chain whose hidden regime changes, with p = 0.001 or 1e-5 and twice as much."""
    first = untuned_problem("regimes_1e-3" if p == 1e-3 else "regimes_1e-5")
    system = first.system
    assert isinstance(system, Regimes)
    level = bisect(lambda x: 2.0 * p - system.crossing(x, first.steps), 0.0, 0.5, 15.0)
    doubled = Problem(system, avrare.stl(f"always (x < {level!r})"), first.steps)
    return {1.0: first.problem(), 2.0: doubled}


_SYSTEMS: dict[str, Callable[[], dict[float, Problem]]] = {
    "walk": walks,
    "hidden regimes": partial(regimes, 1e-3),
    "rare regimes": partial(regimes, 1e-5),
}


def pool_of(path: Path, problem: Problem, runs: int, name: str, **sizes: int) -> tuple[Floats, Floats]:
    """Return (runs,) probabilities and roots; parts that are in files are not simulated again."""
    path.parent.mkdir(parents=True, exist_ok=True)
    parts = []
    for part in range(-(-runs // _PART)):
        file = path.with_name(f"{path.name}_{part}.npy")
        if not file.exists():
            result = avrare.estimate(problem, name, seed=part, runs=_PART, **sizes)
            np.save(file, np.array([result.run_probabilities, result.diagnostics["roots"]]))
        parts.append(np.load(file))
    probabilities, roots = np.concatenate(parts, axis=1)[:, :runs]
    return probabilities, roots


_TEMPLATE = avrare.estimate(linear(1.0, dim=1).problem(), "mc", rollouts=10)


def monte_carlo(rng: np.random.Generator, p: float, eighth: int, factor: float, share: int) -> Result:
    """Draw the count of failures."""
    rollouts = eighth * share
    failures = int(rng.binomial(rollouts, factor * p))
    at = partial(intervals.clopper_pearson, failures, rollouts)
    return replace(_TEMPLATE, probability=failures / rollouts, interval_at=at, rollouts=rollouts, health={})


def runs_of(
    rng: np.random.Generator,
    pools: Mapping[float, tuple[Floats, Floats]],
    factor: float,
    share: int,
) -> Result:
    """Draw two runs for each eighth of the budget, with the warnings that they would have."""
    chosen = rng.integers(0, len(pools[factor][0]), 2 * share)
    values, roots = (one[chosen] for one in pools[factor])
    warnings = health.check_runs(values.tolist(), roots.astype(int).tolist())
    at = interval_of_runs(values, particles=250)  # which matters only where all runs are equal
    return replace(
        _TEMPLATE, probability=float(values.mean()), run_probabilities=values, interval_at=at,
        health=warnings,
    )  # fmt: skip


def draw_baseline(case: Case) -> Result:
    """Return a baseline without warnings, if any of several draws has none."""
    draws = (case.draw(1.0, 8) for _ in range(_DRAWS))
    first = next(draws)
    return next((one for one in draws if not one.health), first) if first.health else first


def compare(case: Case, baseline: Result, factor: float) -> tuple[str, bool]:
    """Return the verdict on a new estimate, and whether it had warnings."""
    criterion = Criterion("gate", baseline.specification, Regression.model_validate({}), baseline)
    new = case.draw(factor, 8)
    return decide_criteria([criterion], lambda _: new, 1.0, {}).get(0, "inconclusive"), bool(new.health)


def at_bound(case: Case, looks: tuple[int, ...]) -> tuple[str, bool]:
    """Return the verdict after up to so many looks at a probability that is exactly the bound."""
    threshold = Threshold.model_validate({"specification": "bound", "probability": case.probability})
    criterion, batches = Criterion("gate", "bound", threshold), []
    for eighths in looks:
        batches.append(case.draw(1.0, eighths))
        whole = pool(batches, 0.01)
        if verdicts := decide_criteria([criterion], lambda _: whole, eighths / 8.0, {}):  # noqa: B023
            return verdicts[0], bool(whole.health)
    return "inconclusive", bool(whole.health)


def drift(rng: np.random.Generator, first: bool) -> float:
    """Return the factor at which a check fails, where each step adds 10 % and each pass is saved."""
    p, factor = 0.01, 1.0
    entries = [monte_carlo(rng, p, 500, factor, 8)] * 2
    while factor < 20.0:
        factor *= 1.1
        new = monte_carlo(rng, p, 500, factor, 8)
        criteria = [
            Criterion("gate", new.specification, Regression.model_validate({}), entry) for entry in entries
        ]
        verdicts = decide_criteria(criteria if first else criteria[1:], lambda _: new, 1.0, {})  # noqa: B023
        if "fail" in verdicts.values():
            return factor
        if "pass" in verdicts.values():
            entries[1] = new
    return factor


if __name__ == "__main__":
    main()
