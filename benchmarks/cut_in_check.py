"""Monte Carlo of rare ends of the recorded cut-ins from the right, among the only ones that may end so.

    python -m benchmarks.cut_in_check [--rules no_hard_impact] [--drivers cc,fsm]

No driver speeds up, so a cut-in that ends in an impact closes in by more than the speed of the impact. Most
rows are drawn of small gaps. ``docs/regulation/check.csv`` gets a row for each rule and driver.
"""

from __future__ import annotations

import argparse
import csv
import math
from itertools import product
from pathlib import Path

import numpy as np
from scipy.special import ndtr, ndtri

import avrare
from avrare.base.special_functions import bisect
from avrare.rollout.problem import Problem
from avrare.stack.closed_loop import ClosedLoop

SCENARIO = "scenarios/motorway_cut_in.yaml"
OUT = Path("docs/regulation/check.csv")
HEADS = ("rule", "driver", "probability", "standard_error", "rollouts")
DRIVERS = ("cruise", "cc", "reg157", "rss", "fsm")
LEAST_CLOSING = {"no_collision": -1.0, "no_hard_impact": 5.56}
"""Closing speed below which no cut-in breaks the rule [m/s]; for a touch with a margin."""
GAPS = ((0.0, 0.2, 30_000), (0.2, 1.0, 5_000))
"""Quantiles of the gap's own number on the tape between which rows are drawn, and how many."""
BLOCK = 5000


def open_problem(driver: str, rule: str) -> Problem:
    """Return the cut-in from the right under the scenario's stack, or a driver with true positions."""
    controller = f"controller={{plugin: reference_driver, model: {driver}}}"
    others = ("perception=null", "tracker=null", "aeb=null")
    return avrare.load(SCENARIO, () if driver == "cruise" else (controller, *others)).problem(rule)


def estimate(problem: Problem, least_closing: float) -> tuple[float, float]:
    """Return the probability that a rule is broken, and its standard error."""
    assert isinstance(problem.system, ClosedLoop)
    assert problem.system.start is not None
    draws, rng = problem.system.start.draws, np.random.default_rng(1)
    closing, gap = (draws.names.index(f"parameters.{name}") for name in ("Closing", "Gap"))
    # The closing speed is the first draw, so it depends on its own number alone.
    score = bisect(lambda z: float(draws.laws[closing].at(np.array([z]))[0]), least_closing, -8.0, 8.0)
    slow, probability, variance = float(ndtr(score)), 0.0, 0.0
    for low, high, rows in GAPS:
        failures = 0
        for _ in range(rows // BLOCK):
            tapes = rng.standard_normal((BLOCK, problem.steps + 1, problem.noise_size))
            for channel, begin, end in ((closing, slow, 1.0), (gap, low, high)):
                tapes[:, 0, channel] = ndtri(begin + (end - begin) * rng.random(BLOCK))
            failures += int((problem.robustness(tapes) <= 0.0).sum())
        weight = (1.0 - slow) * (high - low) / rows
        probability, variance = probability + weight * failures, variance + weight**2 * failures
    return probability, math.sqrt(variance)


def main() -> None:
    """Write the rows that are missing."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--rules", default=",".join(LEAST_CLOSING))
    parser.add_argument("--drivers", default=",".join(DRIVERS))
    args = parser.parse_args()
    done = [tuple(row[:2]) for row in csv.reader(OUT.open())] if OUT.exists() else []
    with OUT.open("a", newline="") as table:
        writer = csv.writer(table, lineterminator="\n")
        if not done:
            writer.writerow(HEADS)
            table.flush()
        for rule, driver in product(args.rules.split(","), args.drivers.split(",")):
            if (rule, driver) not in done:
                probability, error = estimate(open_problem(driver, rule), LEAST_CLOSING[rule])
                rollouts = sum(rows for *_, rows in GAPS)
                writer.writerow((rule, driver, f"{probability:.3g}", f"{error:.2g}", rollouts))
                table.flush()


if __name__ == "__main__":
    main()
