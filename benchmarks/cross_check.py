"""Cross-checks of `ams` at a fixed size, on problems with exact answers: false alarms, and what they catch.

    python benchmarks/cross_check.py [SEEDS]

An estimate misses where its interval leaves out the truth. On the first three problems both estimators are
right: what disagrees there is a false alarm.
"""

from __future__ import annotations

import sys
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))  # run from anywhere

import avrare
from avrare.estimation.result.result import Result
from benchmarks.studies.untuned_problems import Untuned, untuned_problems

EASY = ("plain_walk", "plain_ou", "unequal")
HARD = ("units_100", "units_rare", "flat_outlier", "late", "hidden_scale")
_DISAGREE = "contradicted"


def main(seeds: int) -> None:
    """Print one row per problem."""
    heads = (
        "problem", "results", "agree", "disagree", "inconclusive", "check above, missed", "below, missed",
        "missed", "missed unwarned", "of these caught", "cost",
    )  # fmt: skip
    print(f"| {' | '.join(heads)} |\n|{'---|' * len(heads)}")
    for name in (*EASY, *HARD):
        print(_row(untuned_problems()[name], seeds), flush=True)


def _row(untuned: Untuned, seeds: int) -> str:
    results = [_estimate(untuned, s) for s in range(seeds)]
    outcomes = Counter(one.cross_check.outcome for one in results if one.cross_check)
    missed = [one for one in results if not one.interval[0] <= untuned.probability <= one.interval[1]]
    quiet = [one for one in missed if not set(one.health) - {_DISAGREE}]
    above = [one for one in results if _DISAGREE in one.health and _is_above(one)]
    below = [one for one in results if _DISAGREE in one.health and not _is_above(one)]
    checks = [(one.cross_check.result, one) for one in results if one.cross_check]
    cost = sum(check.simulated_steps / one.simulated_steps for check, one in checks if check)
    pairs = [f"{len(some)}, {sum(one in missed for one in some)}" for some in (above, below)]
    counts = [len(missed), len(quiet), sum(_DISAGREE in one.health for one in quiet)]
    return " | ".join(
        map(str, [f"| {untuned.name}", seeds, *(outcomes[n] for n in ("agree", "disagree", "inconclusive")),
                  *pairs, *counts, f"{cost / seeds:.1%} |"])
    )  # fmt: skip


def _estimate(untuned: Untuned, seed: int) -> Result:
    return avrare.estimate(untuned.problem(), "ams", seed=seed, cross_check=True, grow=False)


def _is_above(result: Result) -> bool:
    check = result.cross_check
    return check is not None and check.result is not None and check.result.probability > result.probability


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 200)
