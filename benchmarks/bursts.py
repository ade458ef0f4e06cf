"""Errors that last: what bursts of misses do to the rules of the lane change, for docs/perception.md.

    OMP_NUM_THREADS=1 python benchmarks/bursts.py [--rollouts 6000] [--only 0.5,0]     # six minutes of CPU
    python benchmarks/bursts.py --lengths

Monte Carlo with the compiled planner, for time constants of detection and position together and each alone.
Every setting has noise of its own. The same tape would be of no use: with another time constant it is another
course of errors, so that rollouts do not pair. The second form says how long runs of misses are in the mean,
by the share that is missed, for a vehicle whose probability of detection stays what it is.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from avrare.estimation.intervals import clopper_pearson
from avrare.rollout.engine import simulate
from avrare.rollout.loaded_scenario import LoadedScenario
from avrare.rollout.noise import NoiseSource
from avrare.rollout.request import Request, Rollouts
from avrare.scenario.load import load

SCENARIO, CHUNK = "scenarios/lane_change_published.yaml", 250
SETTINGS = ((0.0, 0.0), (0.2, 0.2), (0.5, 0.5), (1.0, 1.0), (0.5, 0.0), (0.0, 0.5))
"""Time constants [s] of detection and position."""

LONG = 5
"""Steps of a long run of misses: half a second."""


@dataclass(frozen=True)
class Outcome:
    """Outcome of all rollouts of one setting.

    Attributes:
        violated: (N, rules).
        error: (N,) rows that broke down.
        missed: (N, steps, vehicles), False in rows that broke down.
    """

    violated: NDArray[np.bool_]
    error: NDArray[np.bool_]
    missed: NDArray[np.bool_]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--rollouts", type=int, default=6000)
    parser.add_argument("--only", metavar="DETECTION,POSITION", help="one of the settings")
    parser.add_argument("--lengths", action="store_true", help="mean lengths of runs, and nothing else")
    args = parser.parse_args()
    if args.lengths:
        print_lengths()
        return
    for seed, (detection, position) in enumerate(SETTINGS, 1):
        if args.only in (None, f"{detection:g},{position:g}"):
            print_setting(seed, detection, position, args.rollouts)


def print_setting(seed: int, detection: float, position: float, rollouts: int) -> None:
    """Drive one setting: what is missed, and how often each rule is broken."""
    keys = {"detection": detection, "position": position}
    overrides = [f"perception.persistence.{key}={value}" for key, value in keys.items()]
    scenario = LoadedScenario(load(SCENARIO, ["controller.backend=riccati", *overrides]))
    began = time.process_time()
    outcome = drive(scenario, seed, rollouts)
    spent = time.process_time() - began
    print(f"detection {detection:g} s, position {position:g} s; {spent:.0f} s of CPU")
    print("  " + describe_misses(outcome.missed, scenario.stack.scene.names))
    for name, line in zip(scenario.specifications, outcome.violated.T, strict=True):
        print(f"  {name}: {describe_rule(line, outcome.error)}", flush=True)


def drive(scenario: LoadedScenario, seed: int, rollouts: int) -> Outcome:
    """Drive rollouts in chunks, with what was missed at every step."""
    stack, steps = scenario.stack, scenario.steps
    parts = []
    for begin in range(0, rollouts, CHUNK):
        index = np.arange(begin, min(begin + CHUNK, rollouts))
        request = Request.from_start(np.zeros_like(index), index, keep_carries=True)
        noise = NoiseSource(seed, stack.loop.noise_size)
        found = simulate(
            stack.loop, tuple(stack.specifications.values()), steps, noise, request, scored=False
        )
        parts.append((found.violated, found.error, missed(found, len(scenario.scene.names))))
    return Outcome(*(np.concatenate(part) for part in zip(*parts, strict=True)))


def missed(found: Rollouts, vehicles: int) -> NDArray[np.bool_]:
    """Return (N, steps, vehicles) from the kept states."""
    observed = [(rows, carry.system.observation) for t, rows, carry in found.carries if t > 0]
    result = np.zeros((len(found.error), len(observed), vehicles), dtype=bool)
    for step, (rows, observation) in enumerate(observed):
        result[rows, step] = ~observation.detected
    result[found.error] = False
    return result


def runs(missed: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return lengths of all runs of misses in rows (M, steps), in steps."""
    edges = np.diff(np.pad(missed, ((0, 0), (1, 1))).astype(np.int8), axis=1)
    return np.argwhere(edges < 0)[:, 1] - np.argwhere(edges > 0)[:, 1]


def describe_misses(missed: NDArray[np.bool_], names: tuple[str, ...]) -> str:
    """Return share missed, mean length of a run and rollouts with a long one, of each vehicle."""
    words = []
    for vehicle, name in enumerate(names):
        mine = missed[:, :, vehicle]
        lasting = np.lib.stride_tricks.sliding_window_view(mine, LONG, axis=1).all(axis=-1).any(axis=1)
        words.append(
            f"{name}: {mine.mean():.2%} missed, in runs of {runs(mine).mean():.2f} steps, "
            f"{lasting.mean():.2%} of rollouts with one of {LONG} or more"
        )
    return "; ".join(words)


def describe_rule(violated: NDArray[np.bool_], error: NDArray[np.bool_]) -> str:
    """Return failures, probability, 95 % interval."""
    failures, errors, total = int((violated & ~error).sum()), int(error.sum()), len(error)
    low, high = clopper_pearson(failures, total, 0.95, errors=errors)
    return f"{failures}/{total} = {failures / total:.3%} ({low:.3%}, {high:.3%}), {errors} errors"


def print_lengths() -> None:
    """Print mean lengths of runs of misses [steps of 0.1 s] in the steady state, exactly."""
    for seconds in (0.0, 0.2, 0.5, 1.0):
        lengths = (mean_run(share, seconds) for share in (0.05, 0.2, 0.5))
        print(f"{seconds:g} s: " + ", ".join(f"{length:.2f}" for length in lengths))


def mean_run(share: float, seconds: float, dt: float = 0.1) -> float:
    """Return the mean length of a run: each ends once, so it is share / P(missed now, seen next)."""
    from scipy.stats import multivariate_normal, norm

    correlation = np.exp(-dt / seconds) if seconds else 0.0
    bound = norm.ppf(share)
    both = multivariate_normal(cov=[[1.0, correlation], [correlation, 1.0]]).cdf([bound, bound])
    return float(share / (share - both))


if __name__ == "__main__":
    main()
