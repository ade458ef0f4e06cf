"""How often the gate decides by default: estimates of `auto` against baselines of their own.

    python benchmarks/gate_default.py [--estimates 20] [--folder benchmarks/results/gate_default]

The system is that of `avrare new scenario --python`, with a collision in 3.5e-5 of the drives, and in three
times as many at a smaller time gap. Each estimate has a seed of its own and is kept in the folder, so that an
interrupted study goes on. There are half as many baselines as checks, and each meets every check: the
verdicts depend on each other. Before it stands Monte Carlo at p = 0.0125, whose counts have one law for all
systems.
"""

from __future__ import annotations

import argparse
import contextlib
import io
from collections import Counter
from collections.abc import Iterator, Sequence
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
CONDITIONS = {"baseline": 1.43, "check": 1.43, "tripled": 1.38}
"""Time gaps [s]."""


def main() -> None:
    """Draw the estimates that are missing, and print the shares of the verdicts."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--estimates", type=int, default=20, help="of checks (default 20)")
    parser.add_argument("--folder", type=Path, default=Path("benchmarks/results/gate_default"))
    args = parser.parse_args()
    for results in (draw_frequent(40), draw_rare(args.folder, args.estimates)):
        for condition in ("check", "tripled"):
            report(condition, results["baseline"], results[condition])


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


def draw_frequent(count: int) -> dict[str, list[Result]]:
    """Return estimates of a problem that fails as often as the lane change."""
    results: dict[str, list[Result]] = {}
    for place, (condition, p) in enumerate({"baseline": 0.0125, "check": 0.0125, "tripled": 0.0375}.items()):
        goal = GOALS["baseline" if condition == "baseline" else "check"]
        problem = linear(NormalDist().inv_cdf(1.0 - p), dim=1).problem(chunk=1000)
        results[condition] = [
            avrare.estimate(problem, "auto", relative_error=goal, seed=1000 * place + number)
            for number in range(count)
        ]
    return results


def report(condition: str, baselines: Sequence[Result], estimates: Sequence[Result]) -> None:
    """Print how often checks pass and fail against the baselines that decide, and what both cost."""
    regression, looks = Regression.model_validate({}), Counter[int]()
    fine = [baseline for baseline in baselines if not describe_coarse_baseline(regression, baseline)]
    verdicts = Counter[str]()
    for baseline in fine:
        criterion = Criterion("gate", baseline.specification, regression, baseline)
        for number in range(len(estimates)):
            batches = [estimates[number], estimates[number - 1]]  # the second look is another's first
            verdict, drawn = decide_in_looks(criterion, batches)
            verdicts[verdict] += 1
            looks[drawn] += 1
    shares = ", ".join(f"{name} {count / verdicts.total():.1%}" for name, count in verdicts.most_common())
    for name, results in (("baseline", baselines), (condition, estimates)):
        mean = np.mean([each.probability for each in results])
        warned = sum(bool(each.health) for each in results)
        rollouts = np.mean([each.rollouts for each in results])
        print(
            f"  {name}: {len(results)} estimates, mean {mean:.3g}, {rollouts:,.0f} rollouts, {warned} warned"
        )
    print(f"{condition}: {shares}; {len(fine)} baselines decide, {looks[2]} of {looks.total()} look twice")


def decide_in_looks(criterion: Criterion, batches: Sequence[Result]) -> tuple[str, int]:
    """Return the verdict of a check that looks again where it is not decided, and its looks."""
    for drawn in range(1, len(batches) + 1):
        pooled = pool(batches[:drawn], 0.01)
        decided = decide_criteria([criterion], {criterion: pooled}.get, 1.0 / len(batches), {})
        if decided:
            return decided[0], drawn
    return "inconclusive", len(batches)


if __name__ == "__main__":
    main()
