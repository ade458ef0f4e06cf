"""Shares of the verdicts of the gate by default: estimates of `auto` against baselines of their own.

    python benchmarks/gate_default.py [--estimates 20] [--folder benchmarks/results/gate_default]

The system is that of `avrare new scenario --python`, with a collision in 3.5e-5 of the drives (278 of
8,000,000), and in 2.5 times as many (708) at a smaller time gap. Each estimate has a seed of its own and is
kept in the folder, so that an interrupted study goes on. There are half as many baselines as checks, and each
meets every check: the verdicts depend on each other. Before it stands Monte Carlo at p = 0.0125, whose counts
have one law for all systems and are drawn from it.
"""

from __future__ import annotations

import argparse
import contextlib
import io
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
from avrare.cli.main import main as run_command
from avrare.estimation.combine.specifications import Execution
from avrare.estimation.result.confidence_distributions import InverseBinomial, derive_distribution
from avrare.estimation.result.result import Result
from avrare.rollout.loaded_scenario import LoadedScenario
from avrare.scenario.load import load
from avrare.scenario.schema import Regression
from avrare.testing.problems import linear

GOALS = {
    kind: float((share * find_variance(Regression.model_validate({}))) ** 0.5)
    for kind, share in (("baseline", BASELINE_SHARE), ("check", 1.0 - BASELINE_SHARE))
}
"""Relative errors that a check without a budget asks for."""
CONDITIONS = {"baseline": 1.43, "check": 1.43, "worse": 1.38}
"""Time gaps [s]."""
REGRESSION = Regression.model_validate({})
Check = tuple[Result, tuple[Result, Result]]
"""A baseline, and the estimates of both looks."""


def main() -> None:
    """Draw the estimates that are missing, and print the shares of the verdicts."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--estimates", type=int, default=20, help="of checks (default 20)")
    parser.add_argument("--counts", type=int, default=1000, help="checks by counts (default 1000)")
    parser.add_argument("--folder", type=Path, default=Path("benchmarks/results/gate_default"))
    args = parser.parse_args()
    for factor in (1.0, 3.0):
        report(f"mc, {factor:g} times p = 0.0125", draw_counts(0.0125, factor, args.counts))
    estimates = draw_rare(args.folder, args.estimates)
    for condition in ("check", "worse"):
        report(f"auto, {condition}", list(pair_all(estimates["baseline"], estimates[condition])))


def draw_rare(folder: Path, count: int) -> dict[str, list[Result]]:
    """Return the estimates of each condition, of which those in the folder are read."""
    folder.mkdir(parents=True, exist_ok=True)
    if not (folder / "acc.yaml").exists():
        with contextlib.redirect_stdout(io.StringIO()):
            run_command(["new", "scenario", "acc", "--python", "--out", str(folder)])
    for number in range(count):
        for place, (condition, gap) in enumerate(CONDITIONS.items()):
            enough = number if condition == "check" else 2 * number
            if enough >= count or len(list((folder / condition).glob("*.json"))) > number:
                continue
            settings = [f"controller.options.time_gap={gap}", f"seed={1000 * place + number}"]
            definition = load(str(folder / "acc.yaml"), settings)
            goal = GOALS["baseline" if condition == "baseline" else "check"]
            scenario = LoadedScenario(definition)
            results = estimate_look(scenario, definition.estimated, Look(1, 1.0, None), Execution(), goal)
            baseline_files.save(folder / condition, definition, results)
    return {condition: list(read_estimates(folder / condition)) for condition in CONDITIONS}


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
