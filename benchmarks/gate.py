"""Error rates of the gate: false alarms on an unchanged system, and doublings that it catches.

    python benchmarks/gate.py [--checks 200]

Each check draws a baseline and a new estimate of a system whose failure probability is known, both afresh,
and compares them as ``avrare check`` does with its default tolerance. "unchanged" should fail in at most
2.5 % of the checks, "doubled" in at least 90 % where the budget is the one that docs/ci.md asks for. The last
line is the threshold ``< p`` of a system that lies exactly at it, at the looks of ``--spend``: no more than
2.5 % may fail, however often it is looked.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from statistics import NormalDist

import avrare
from avrare.analysis.check.baseline_files import BaselineEntry
from avrare.analysis.check.criteria import Criterion, decide_criteria
from avrare.analysis.check.pooling import pool
from avrare.analysis.check.targets import SHARES
from avrare.estimation.result import Result
from avrare.scenario.schema import Regression, Threshold
from avrare.testing.problems import linear, walk

Draw = Callable[[float, int], Result]
"""(factor on the probability, seed) -> an estimate."""


@dataclass(frozen=True)
class Case:
    """An estimator at the budget that docs/ci.md gives for it.

    Attributes:
        name: What it is.
        draw: Gives one estimate.
    """

    name: str
    draw: Draw


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--checks", type=int, default=200, help="of each kind (default 200)")
    checks = parser.parse_args().checks
    print(f"{checks} checks each; a baseline and a new estimate of their own for every one\n")
    print(f"{'estimate':<44}{'system':<12}{'fail':>7}{'pass':>7}{'unclear':>9}")
    for case in cases():
        pairs = [compare(case.draw, number) for number in range(checks)]
        report(case.name, "unchanged", Counter(unchanged for unchanged, _ in pairs))
        report(case.name, "doubled", Counter(doubled for _, doubled in pairs))
    report("mc, threshold, up to four looks", "at the bound", Counter(sequential(n) for n in range(checks)))


def report(name: str, system: str, found: Counter[str]) -> None:
    """One line."""
    print(f"{name:<44}{system:<12}{found['fail']:>7}{found['pass']:>7}{found['inconclusive']:>9}", flush=True)


def cases() -> list[Case]:
    """Monte Carlo with about 40, 4 and 0 failures in the baseline, and splitting."""
    return [
        Case("mc, p = 0.01, 4,000 rollouts", monte_carlo(0.01, 4000)),
        Case("mc, p = 0.001, 4,000 rollouts", monte_carlo(0.001, 4000)),
        Case("mc, p = 0.0001, 4,000 rollouts", monte_carlo(0.0001, 4000)),
        Case("ams, p = 0.001, 15 runs of 250 particles", splitting),
    ]


def monte_carlo(p: float, rollouts: int) -> Draw:
    """One normal number beyond a bound."""

    def draw(factor: float, seed: int) -> Result:
        bound = -NormalDist().inv_cdf(factor * p)
        problem = linear(bound, dim=1).problem(chunk=rollouts)
        return avrare.estimate(problem, "mc", seed=seed, rollouts=rollouts)

    return draw


def splitting(factor: float, seed: int) -> Result:
    """A random walk of 8 steps, with the levels at which p = 0.001 and 0.002."""
    problem = walk({1.0: 0.8879303823027385, 2.0: 0.830314331268937}[factor], steps=8).problem(chunk=5000)
    return avrare.estimate(problem, "ams", seed=seed, particles=250, discard=25, runs=15)


def compare(draw: Draw, number: int) -> tuple[str, str]:
    """The verdicts on the unchanged and on the doubled system, against one baseline."""
    baseline = BaselineEntry.from_result(draw(1.0, 3 * number))
    criterion = Criterion("gate", baseline.specification, Regression.model_validate({}), baseline)

    def verdict(factor: float, seed: int) -> str:
        new = draw(factor, seed)
        return decide_criteria([criterion], lambda _: new, 1.0, {}).get(0, "inconclusive")

    return verdict(1.0, 3 * number + 1), verdict(2.0, 3 * number + 2)


def sequential(number: int) -> str:
    """The verdict after up to four looks at a probability that is exactly the bound."""
    p, spend = 0.01, 16_000
    criterion = Criterion(
        "gate", "bound", Threshold.model_validate({"specification": "bound", "probability": p})
    )
    batches: list[Result] = []
    verdicts: dict[int, str] = {}
    for look, share in enumerate(SHARES):
        batches.append(monte_carlo(p, int(spend * share))(1.0, len(SHARES) * number + look))
        verdicts = decide_criteria([criterion], lambda _: pool(batches, 0.01), share, verdicts)
        if verdicts:
            break
    return verdicts.get(0, "inconclusive")


if __name__ == "__main__":
    main()
