"""Overhead of avrare on top of a Gymnasium environment, side by side in one process.

    OMP_NUM_THREADS=1 python benchmarks/worlds.py [ROLLOUTS]

bare     the environment is reset and stepped with the very actions of avrare's rollouts, nothing else
abreast  the same, but as many environments as a chunk has rollouts are stepped in turn: what it costs that
         each finds the caches full of the others
avrare   Monte Carlo of the same rollouts: noise, controller, monitor and estimate too

All end a rollout's stepping where the environment ends. CPU time, the least of five turns each.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import avrare
from avrare.rollout.noise import NoiseSource
from avrare_gymnasium.stream import bits
from avrare_gymnasium.world import GymWorld

TURNS = 5
SCENARIOS = Path(__file__).parents[1] / "scenarios"
# The bare environment draws from its own generator at every step, so avrare is to do the same here.
STREAM = "simulator.noise.stream={by: seed, at: reset}"
CASES = {"cartpole": "upright", "pendulum": "upright", "lunar_lander": "upright"}
Course = tuple[int, list[Any]]
"""Seed of the reset, and the actions."""


def courses(problem: avrare.Problem, rollouts: int) -> list[Course]:
    """Return the inputs of the environment in every rollout."""
    index = np.arange(rollouts)[:, None]
    tape = NoiseSource(0, problem.noise_size).normals(0, 0, index, np.arange(problem.steps + 1))
    state = problem.system.initial(tape[:, 0])
    for t in range(1, problem.steps + 1):
        state = problem.system.step(state, tape[:, t])
    return [(bits(track.noise[0][:1]), track.actions) for track in state.world.track]


def bare(env: Any, options: dict[str, Any] | None, todo: list[Course]) -> int:
    """Return the steps taken."""
    steps = 0
    for seed, actions in todo:
        env.reset(seed=seed, options=options)
        for action in actions:
            _, _, terminated, truncated, _ = env.step(action)
            steps += 1
            if terminated or truncated:
                break
    return steps


def abreast(envs: list[Any], options: dict[str, Any] | None, todo: list[Course]) -> None:
    """Take the same steps in the order in which a batch takes them."""
    for first in range(0, len(todo), len(envs)):
        block = list(zip(envs, todo[first : first + len(envs)], strict=False))
        for env, (seed, _) in block:
            env.reset(seed=seed, options=options)
        alive = [True] * len(block)
        for t in range(len(todo[0][1])):
            for i, (env, (_, actions)) in enumerate(block):
                if alive[i]:
                    _, _, terminated, truncated, _ = env.step(actions[t])
                    alive[i] = not (terminated or truncated)


def seconds(function: Callable[[], Any]) -> float:
    """Return CPU time of a call."""
    began = time.process_time()
    function()
    return time.process_time() - began


def compared(name: str, specification: str, rollouts: int) -> str:
    """Return a line for one environment."""
    scenario = avrare.load(SCENARIOS / f"{name}.yaml", [STREAM])
    problem, config = scenario.problem(specification), scenario.definition.simulator.config
    todo, options = courses(problem, rollouts), config.reset or None
    envs = [GymWorld(config).env for _ in range(problem.chunk)]
    steps = bare(envs[0], options, todo)
    ways: dict[str, Callable[[], Any]] = {
        "bare": lambda: bare(envs[0], options, todo),
        "abreast": lambda: abreast(envs, options, todo),
        "avrare": lambda: avrare.estimate(problem, "mc", rollouts=rollouts),
    }
    best = dict.fromkeys(ways, np.inf)
    for _ in range(TURNS):
        for way, run in ways.items():
            best[way] = min(best[way], 1e6 * seconds(run) / steps)
    parts = [f"{way} {micro:6.1f} us ({micro / best['bare']:.2f})" for way, micro in best.items()]
    return f"{name:13s} {steps:6d} steps  " + "  ".join(parts)


def main(rollouts: int) -> None:
    """Print a line for each environment."""
    for name, specification in CASES.items():
        print(compared(name, specification, rollouts))


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 100)
