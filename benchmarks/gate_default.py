"""Shares of the verdicts of the gate: estimates against baselines, each with noise of its own.

    python benchmarks/gate_default.py [SYSTEM] [--estimates 20] [--folder benchmarks/results/gate_default]

* `counted` is Monte Carlo at p = 0.0125, whose counts have one law for all systems and are drawn from it.
* `cruise_control` is the system of `avrare new scenario --python`, with a collision in 3.5e-5 of the drives
  (278 of 8,000,000), and in 2.5 times as many (708) at a smaller time gap.
* `lane_change` comes nearer than 0.6 m to somebody, and more often where the planner wants 0.9 m of room
  across the road in place of 1.5 m.
* `lane_change_rare` has hard impacts, and more by the same change. Its estimates are drawn from the weights
  of 4,000 drives by the learned proposal for each of them that is asked for.

Estimates and weights are kept in the folder, so that an interrupted study goes on. There are half as many
baselines as checks, and each meets every check: the verdicts depend on each other.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from statistics import NormalDist

import numpy as np

import avrare
from avrare.analysis.check import baseline_files
from avrare.analysis.check.criteria import Criterion, decide_criteria
from avrare.analysis.check.pooling import pool
from avrare.analysis.check.power_analysis import BASELINE_SHARE, describe_coarse_baseline, find_variance
from avrare.analysis.check.targets import Look, estimate_look
from avrare.base.philox import Floats
from avrare.cli.main import main as run_command
from avrare.estimation.combine.specifications import Execution
from avrare.estimation.result.confidence_distributions import (
    InverseBinomial,
    LogNormal,
    derive_distribution,
)
from avrare.estimation.result.result import Result
from avrare.rollout.loaded_scenario import LoadedScenario
from avrare.scenario.load import load
from avrare.scenario.schema import Regression, Scenario
from avrare.testing.problems import linear
from avrare_estimators.common import health

GOALS = {
    kind: float((share * find_variance(Regression.model_validate({}))) ** 0.5)
    for kind, share in (("baseline", BASELINE_SHARE), ("check", 1.0 - BASELINE_SHARE))
}
"""Relative errors that a check without a budget asks for."""
CONDITIONS = ("baseline", "check", "worse")
SYSTEMS = ("counted", "cruise_control", "lane_change", "lane_change_rare")
NEAR_MISS = ("specifications.near_miss.stl=always (gap > 0.6)", "estimator={plugin: auto}")
BATCH_ROLLOUTS = 4000
"""Rollouts of a file of weights."""
REGRESSION = Regression.model_validate({})
Check = tuple[Result, tuple[Result, Result]]
"""A baseline, and the estimates of both looks."""


def main() -> None:
    """Draw the estimates that are missing, and print the shares of the verdicts."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("system", nargs="?", choices=SYSTEMS, help="default: all")
    parser.add_argument("--estimates", type=int, default=20, help="of checks (default 20)")
    parser.add_argument("--counts", type=int, default=1000, help="checks by counts or weights (default 1000)")
    parser.add_argument("--folder", type=Path, default=Path("benchmarks/results/gate_default"))
    args = parser.parse_args()
    for system in [args.system] if args.system else SYSTEMS:
        if system == "counted":
            studies = {f"{factor:g} times": draw_counts(0.0125, factor, args.counts) for factor in (1.0, 3.0)}
        elif system == "lane_change_rare":
            studies = draw_weighed(args.folder / system, args.estimates, args.counts)
        else:
            estimates = draw_estimates(system, args.folder / system, args.estimates)
            studies = {
                condition: list(pair_all(estimates["baseline"], estimates[condition]))
                for condition in CONDITIONS[1:]
            }
        for condition, checks in studies.items():
            report(f"{system}, {condition}", checks)


def draw_estimates(system: str, folder: Path, count: int) -> dict[str, list[Result]]:
    """Return the estimates of each condition, of which those in the folder are read."""
    for number in range(count):
        for place, condition in enumerate(CONDITIONS):
            enough = number if condition == "check" else 2 * number
            if enough >= count or len(list((folder / condition).glob("*.json"))) > number:
                continue
            definition = load_system(system, folder, condition, [f"seed={1000 * place + number}"])
            names = ["near_miss"] if system == "lane_change" else definition.estimated
            goal = GOALS["baseline" if condition == "baseline" else "check"]
            results = estimate_look(LoadedScenario(definition), names, Look(1, 1.0, None), Execution(), goal)
            baseline_files.save(folder / condition, definition, results)
    return {condition: list(read_estimates(folder / condition)) for condition in CONDITIONS}


def load_system(system: str, folder: Path, condition: str, settings: Sequence[str]) -> Scenario:
    """Return a scenario in one condition."""
    folder.mkdir(parents=True, exist_ok=True)
    worse = condition == "worse"
    if system != "cruise_control":
        changes = [f"controller.clearance_y={0.9 if worse else 1.5}"]
        changes += NEAR_MISS if system == "lane_change" else ()
        return load(f"scenarios/{system}.yaml", [*changes, *settings])
    if not (folder / "acc.yaml").exists():
        with contextlib.redirect_stdout(io.StringIO()):
            run_command(["new", "scenario", "acc", "--python", "--out", str(folder)])
    gap = f"controller.options.time_gap={1.38 if worse else 1.43}"
    return load(str(folder / "acc.yaml"), [gap, *settings])


def read_estimates(folder: Path) -> Iterator[Result]:
    """Yield the stored estimates."""
    for path in sorted(folder.glob("*.json")):
        yield from baseline_files.read(path).entries.values()


def pair_all(baselines: Sequence[Result], estimates: Sequence[Result]) -> Iterator[Check]:
    """Yield each baseline that decides with each estimate and another one for the second look."""
    for baseline in baselines:
        if not describe_coarse_baseline(REGRESSION, baseline):
            for number in range(len(estimates)):
                yield baseline, (estimates[number], estimates[number - 1])


def draw_counts(p: float, factor: float, count: int) -> list[Check]:
    """Return checks by Monte Carlo, which ends at the failures that its goal asks for."""
    problem, rng = linear(NormalDist().inv_cdf(1.0 - p), dim=1).problem(chunk=1000), np.random.default_rng(0)

    def draw(kind: str, p: float) -> Result:
        law = derive_distribution(templates[kind])
        assert isinstance(law, InverseBinomial)
        trials = law.failures + int(rng.negative_binomial(law.failures, p))
        mean, drawn = (law.failures - 1) / (trials - 1), InverseBinomial(law.failures, trials)
        return replace(templates[kind], probability=mean, rollouts=trials, interval_at=drawn.interval_at)

    templates = {kind: avrare.estimate(problem, "auto", relative_error=goal) for kind, goal in GOALS.items()}
    return [
        (draw("baseline", p), (draw("check", factor * p), draw("check", factor * p))) for _ in range(count)
    ]


def draw_weighed(folder: Path, batches: int, count: int) -> dict[str, list[Check]]:
    """Return checks by importance sampling, of the sizes that their goals ask for."""
    rng, template = np.random.default_rng(0), avrare.estimate(linear(3.0, dim=1).problem(), "mc", rollouts=10)

    def draw(rows: Floats, goal: float) -> Result:
        sample = rng.choice(rows, math.ceil(rows.var() / rows.mean() ** 2 / goal**2))
        mean, total = float(sample.mean()), float(sample.sum())
        variance = float(sample.var()) / len(sample) / mean**2
        effective = total**2 / float((sample**2).sum())
        law = LogNormal(mean, variance, max(1, int(effective) - 1))
        return replace(
            template,
            probability=mean,
            relative_error=math.sqrt(variance),
            rollouts=len(sample),
            interval_at=law.interval_at,
            health=health.check_weights(1.0, 0.0, effective, float(sample.max()) / total),
        )

    rows = {condition: draw_weights(folder, condition, batches) for condition in CONDITIONS[1:]}
    return {
        condition: [
            (baseline, (draw(rows[condition], GOALS["check"]), draw(rows[condition], GOALS["check"])))
            for _ in range(count)
            if not describe_coarse_baseline(REGRESSION, baseline := draw(rows["check"], GOALS["baseline"]))
        ]
        for condition in rows
    }


def draw_weights(folder: Path, condition: str, batches: int) -> Floats:
    """Return what each drive adds to the probability, of which those in the folder are read."""
    rows = []
    for number in range(0, batches, 1 + (condition == "worse")):
        path = folder / f"{condition}-{number}.npz"
        if not path.exists():
            size = ["estimator.relative_error=null", f"estimator.rollouts={BATCH_ROLLOUTS}"]
            seed = 100 + 1000 * (condition == "worse") + number
            definition = load_system("lane_change_rare", folder, condition, [*size, f"seed={seed}"])
            names = definition.estimated
            (result,) = estimate_look(LoadedScenario(definition), names, Look(1, 1.0, None), Execution())
            assert result.failures.weights is not None
            np.savez(path, weights=result.failures.weights, failures=result.failures.count)
        batch = np.load(path)
        weights = batch["weights"]
        drives = round(BATCH_ROLLOUTS * len(weights) / int(batch["failures"]))  # for which those kept stand
        rows += [drives * weights, np.zeros(drives - len(weights))]
    return np.concatenate(rows)


def report(title: str, checks: Sequence[Check]) -> None:
    """Print how often checks pass and fail, and what they cost."""
    verdicts, looks, spent = Counter[str](), 0, 0
    for baseline, batches in checks:
        criterion = Criterion("gate", baseline.specification, REGRESSION, baseline)
        verdict, drawn = decide_in_looks(criterion, batches)
        verdicts[verdict] += 1
        looks += drawn
        spent += sum(batch.rollouts for batch in batches[:drawn])
    shares = ", ".join(f"{name} {count / len(checks):.1%}" for name, count in verdicts.most_common())
    before = np.mean([baseline.rollouts for baseline, _ in checks])
    print(f"{title}: {shares} of {len(checks)}; {looks / len(checks):.2f} looks")
    print(f"  rollouts: baseline {before:,.0f}, check {spent / len(checks):,.0f}", flush=True)


def decide_in_looks(criterion: Criterion, batches: Sequence[Result]) -> tuple[str, int]:
    """Return the verdict of a check that looks again where it is not decided, and its looks."""
    for drawn in range(1, len(batches) + 1):
        if verdict := decide_once(criterion, pool(batches[:drawn], 0.01), 1.0 / len(batches)):
            return verdict, drawn
    return "inconclusive", len(batches)


def decide_once(criterion: Criterion, result: Result, share: float) -> str | None:
    """Return the verdict at a look with this share of the error rate; None where it is open."""
    return decide_criteria([criterion], lambda _: result, share, {}).get(0)


if __name__ == "__main__":
    main()
