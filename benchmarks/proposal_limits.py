"""Why a climb: what proposals gain on rare failures of the lane change, and how fast chains move there.

    OMP_NUM_THREADS=1 python -m benchmarks.proposal_limits [--rule no_collision] [--steps 8]
        [--angles 0.1,0.2] [--parts gains,mixing,offspring,decided,chances]

It takes the truth's rollouts whose robustness one in 1,000 reaches, a sample of the target. Gains: proposals
fitted to some of them are judged on half of those at 1e-4, which they have not seen: the gain over Monte
Carlo is 1 over the mean of p/q. Mixing: chains start at all of them and stay at that level: of those that
began at 1e-4 the share that is still there tells how much they remember; 0.1 is nothing. Offspring: how
unlike the starts are in where chains lead from them, to 1e-4 and on to 1e-5. Decided: the noise after a
step is drawn anew; the share that still reaches the level tells how much is decided by then. Chances: the
same for each of some failures, many times over: how likely it was to fail, given all that was at the step.
"""

from __future__ import annotations

import argparse
import math
from typing import Any

import numpy as np

from avrare.base import batch
from avrare.protocols import Bools, Floats
from avrare.rollout.problem import Problem
from avrare_estimators.ess.chains import rotated
from avrare_estimators.importance.dictionary import fit
from benchmarks.prune_proposal import DEFENSIVE, failing_tapes, gain
from benchmarks.studies import truth
from benchmarks.studies.levels import Level, read_level, truth_file

SCENARIO = "lane_change"
SIZES = (80, 150, 300, 500, 900)
TIMES = (8, 16, 20, 24, 28, 32, 40, 48, 56, 64)
"""Steps after which noise is drawn anew."""
_ROWS = 250
_FAILURES, _REDRAWS = 80, 150
"""Failures whose chances are estimated, and continuations of each."""
_CHANCE_TIMES = (20, 28, 40, 48, 56, 64)


def tapes_at(rule: str, probability: float) -> tuple[Problem, Floats]:
    """Return a rule at a level, and the tapes (M, T + 1, D) of the truth that reach it."""
    problem, _ = read_level(SCENARIO, rule, probability)
    (monitor,) = problem.monitors
    assert isinstance(monitor, Level)
    shape = (problem.steps + 1, problem.noise_size)
    return problem, failing_tapes(truth_file(SCENARIO), rule, monitor.level, shape)


def print_gains(common: Floats, rare: Floats, rng: np.random.Generator) -> None:
    """Print the gain on half of the rare tapes of proposals fitted to some of the others."""
    print("| rows at 1e-3 | gain at 1e-4, three draws |\n|---|---|")
    for size in SIZES:
        found = []
        for _ in range(3):
            held = rare[rng.permutation(len(rare))[: len(rare) // 2]]
            rest = common[~np.isin(common[:, 1, 0], held[:, 1, 0])]
            rows = rest[rng.permutation(len(rest))[:size]]
            found.append(gain(fit(rows, np.ones(len(rows)), DEFENSIVE), held))
        print(f"| {size} | {', '.join(f'{one:.1f}' for one in found)} |", flush=True)


def print_mixing(problem: Problem, tapes: Floats, rare: float, angles: list[float], steps: int) -> None:
    """Print what chains at the level of ``problem`` remember of the rare ones among their starts."""
    print("| step [rad] | accepted | " + " | ".join(f"after {k + 1}" for k in range(steps)) + " |")
    print(f"|{'---|' * (steps + 2)}")
    first = robustness(problem, tapes)
    began = first <= rare
    for angle in angles:
        rng = np.random.default_rng(1)
        place, value, accepted, left = tapes, first, [], []
        for _ in range(steps):
            place, value, good = moved(problem, place, value, 0.0, angle, rng)
            accepted.append(float(good.mean()))
            left.append(float((value <= rare)[began].mean()))
        told = " | ".join(f"{one:.2f}" for one in left)
        print(f"| {angle:g} | {np.mean(accepted):.2f} | {told} |", flush=True)


def print_offspring(
    problem: Problem, tapes: Floats, rares: list[float], angle: float, moves: int = 9
) -> None:
    """Print the relative variance of the offspring of a start at ever rarer levels, all starts in one pass.

    Args:
        problem: The rule at the level of the starts.
        tapes: The starts.
        rares: Robustness of the rarer levels.
        angle: Size of the chains' steps [rad].
        moves: Moves of a chain at a level.
    """
    rng, level, starts = np.random.default_rng(0), 0.0, len(tapes)
    place, value, root = tapes, robustness(problem, tapes), np.arange(starts)
    print("| beyond | share of samples | starts with offspring | relative variance of the offspring |")
    print("|---|---|---|---|")
    for rare in rares:
        places, values = [place], [value]
        for _ in range(moves):
            place, value, _ = moved(problem, place, value, level, angle, rng)
            places.append(place)
            values.append(value)
        beyond = np.array(values) <= rare
        offspring = np.bincount(root, beyond.mean(axis=0), minlength=starts)
        spread = offspring.var() / offspring.mean() ** 2
        print(
            f"| {rare:.3f} | {beyond.mean():.3f} | {np.count_nonzero(offspring)} | {spread:.1f} |", flush=True
        )
        sample, chain = np.nonzero(beyond)
        chosen = rng.permutation(len(sample))[:starts]
        level, root = rare, root[chain[chosen]]
        place = np.array(places)[sample[chosen], chain[chosen]]
        value = np.array(values)[sample[chosen], chain[chosen]]


def print_decided(problem: Problem, tapes: Floats) -> None:
    """Print the share of the tapes that stay at the level when the noise after a step is drawn anew."""
    rng = np.random.default_rng(0)
    print("| noise kept up to step | still at the level |\n|---|---|")
    for time in TIMES:
        mixed = tapes.copy()
        mixed[:, time + 1 :] = rng.standard_normal(mixed[:, time + 1 :].shape)
        print(f"| {time} | {np.mean(robustness(problem, mixed) <= 0.0):.2f} |", flush=True)


def print_chances(problem: Problem, tapes: Floats) -> None:
    """Print how likely failures were to fail, given all of the system's state at a step."""
    rng = np.random.default_rng(0)
    print("| step | failed before | mean chance of the others | 1/10 | 1/4 | 1/2 | 3/4 | 9/10 |")
    print("|---|---|---|---|---|---|---|---|")
    for time, carry in _states_at(problem, tapes, _CHANCE_TIMES).items():
        hits = np.zeros(len(tapes))
        size = max(1, _ROWS // len(tapes))
        for _ in range(math.ceil(_REDRAWS / size)):
            copies = batch.take(carry, np.repeat(np.arange(len(tapes)), size))
            hits += _fails(problem, copies, time, rng).reshape(len(tapes), size).sum(axis=1)
        chance = hits / (math.ceil(_REDRAWS / size) * size)
        before = np.asarray(carry[2].violated)
        others = chance[~before]
        cuts = " | ".join(f"{cut:.3f}" for cut in np.quantile(others, (0.1, 0.25, 0.5, 0.75, 0.9)))
        print(f"| {time} | {before.mean():.2f} | {others.mean():.3f} | {cuts} |", flush=True)


def _states_at(problem: Problem, tapes: Floats, times: tuple[int, ...]) -> dict[int, Any]:
    """Return state, monitor and verdict at each of ``times``."""
    (monitor,), system, found = problem.monitors, problem.system, {}
    state, watch = system.initial(tapes[:, 0]), monitor.start(len(tapes))
    watch, verdict = monitor.update(watch, system.signals(state))
    for time in range(1, max(times) + 1):
        state = system.step(state, tapes[:, time])
        watch, verdict = monitor.update(watch, system.signals(state))
        if time in times:
            found[time] = state, watch, verdict
    return found


def _fails(problem: Problem, carry: Any, time: int, rng: np.random.Generator) -> Bools:
    """Return whether rollouts fail that go on after ``time`` with fresh noise."""
    (monitor,), (state, watch, verdict) = problem.monitors, carry
    shape = (len(verdict.robustness), problem.noise_size)
    for _ in range(time, problem.steps):
        state = problem.system.step(state, rng.standard_normal(shape))
        watch, verdict = monitor.update(watch, problem.system.signals(state))
    return np.asarray(verdict.violated)


def moved(
    problem: Problem, place: Floats, value: Floats, level: float, angle: float, rng: np.random.Generator
) -> tuple[Floats, Floats, Bools]:
    """Return chains, robustness and which have moved, after a step that stays at a robustness."""
    proposed = rotated(place, rng.standard_normal(place.shape), np.full(len(place), angle))
    there = robustness(problem, proposed)
    good = there <= level
    return np.where(good[:, None, None], proposed, place), np.where(good, there, value), good


def robustness(problem: Problem, tapes: Floats) -> Floats:
    """Return the robustness (M,) of tapes; infinite where a rollout breaks down."""
    parts = [problem.replay(tapes[begin : begin + _ROWS]) for begin in range(0, len(tapes), _ROWS)]
    return np.concatenate([np.where(one.error, np.inf, one.robustness[:, 0]) for one in parts])


def main() -> None:
    """Print the tables of a rule."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--rule", default="no_collision")
    parser.add_argument("--steps", type=int, default=8)
    parser.add_argument("--angles", default="0.1,0.2,0.4")
    parser.add_argument("--parts", default="gains,mixing,offspring,decided")
    args = parser.parse_args()
    angles = [float(one) for one in args.angles.split(",")]
    problem, common = tapes_at(args.rule, 1e-3)
    _, rare = tapes_at(args.rule, 1e-4)
    tail = truth.read_tails(truth_file(SCENARIO))[args.rule]
    apart = [tail.threshold(one) - tail.threshold(1e-3) for one in (1e-4, 1e-5)]
    if "gains" in args.parts:
        print_gains(common, rare, np.random.default_rng(0))
    if "mixing" in args.parts:
        print_mixing(problem, common, apart[0], angles, args.steps)
    if "offspring" in args.parts:
        for angle in angles:
            print_offspring(problem, common, apart, angle)
    if "decided" in args.parts:
        print_decided(problem, common[::4])
    if "chances" in args.parts:
        print_chances(problem, common[:: len(common) // _FAILURES][:_FAILURES])


if __name__ == "__main__":
    main()
