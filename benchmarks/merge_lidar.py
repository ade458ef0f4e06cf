"""Case study: a learnt merge policy behind 240 noisy lidar rays: its training, its cost, its failures.

    OMP_NUM_THREADS=1 python benchmarks/merge_lidar.py heldout [--runs 400]
    OMP_NUM_THREADS=1 python benchmarks/merge_lidar.py overhead
    OMP_NUM_THREADS=1 python benchmarks/merge_lidar.py clusters --run RUN [--pictures docs/merge-lidar]

``clusters`` draws from the failing tapes of the folder of a run by Monte Carlo.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

import numpy as np
from studies import merge_clusters

import avrare
from avrare.driving import Vehicles
from avrare_highway_env.config import HighwayEnvConfig
from avrare_highway_env.simulator import HighwayEnvSimulator
from avrare_highway_env.worlds import others_of, read

ROOT = Path(__file__).parents[1]
SCENARIO = ROOT / "scenarios" / "merge_lidar.yaml"


def heldout(runs: int) -> None:
    """Try the policy on starts that it was not trained on, with and without noise on its rays."""
    loaded = avrare.load(SCENARIO)
    controller, config = loaded.stack.loop.controller, loaded.stack.loop.simulator.config
    for variance in (0.0, config.lidar.noise_variance):
        lidar = config.lidar.model_copy(update={"noise_variance": variance})
        own = HighwayEnvConfig.model_validate(
            config.model_copy(update={"start_seed": None, "lidar": lidar}).model_dump()
        )
        simulator, rng = HighwayEnvSimulator(own), np.random.default_rng(2024)
        world = simulator.reset(rng.standard_normal((runs, simulator.noise_size)))
        speeds = [world.ego.speed]
        for _ in range(loaded.steps):
            action, _ = controller.act(None, world.ego, None)
            world = simulator.step(world, action, rng.standard_normal((runs, simulator.noise_size)))
            speeds.append(world.ego.speed)
        windows = np.lib.stride_tricks.sliding_window_view(np.array(speeds)[30:], 5, axis=0)
        slowest = windows.max(axis=-1).min(axis=0)
        print(f"variance {variance}: {world.arrived.sum()} of {runs} arrive, {world.crashed.sum()} crash;")
        print(f"  slowest half second from 3 s on: least {slowest.min():.2f}, ", end="")
        print(f"median {np.median(slowest):.2f} m/s; all stay above 18 m/s: {(slowest > 18.0).all()}")


def overhead(repeats: int = 5, steps: int = 120) -> None:
    """Compare CPU time a step of the closed loop and of environment and policy alone, turn by turn."""
    loaded = avrare.load(SCENARIO, ["simulator.start_seed=284"])
    loop, problem = loaded.stack.loop, loaded.problem("keeps_up")
    rng, times = np.random.default_rng(0), dict.fromkeys(("bare", "parts", "avrare 1", "avrare 10"), 0.0)
    for _ in range(repeats):
        times["bare"] += _bare(loop, steps, rng)
        times["parts"] += _parts(loop, steps, rng)
        for n in (1, 10):
            tapes = rng.standard_normal((n, problem.steps + 1, loop.noise_size))
            times[f"avrare {n}"] += _within(problem, loop, tapes, steps)
    for name, seconds in times.items():
        each = 1e6 * seconds / repeats / steps
        shares = ", ".join(f"{seconds / times[one]:.2f} of {one}" for one in ("bare", "parts"))
        print(f"{name}: {each:.0f} us a step, {shares}")


def _bare(loop: Any, steps: int, rng: np.random.Generator) -> float:
    """Time highway-env as its users run it: own lidar, noise on the rays, the same network, no monitor."""
    setting, network = loop.simulator.setting, loop.controller.network
    lidar = {"type": "LidarObservation", "cells": 240}
    options = {**setting.options, "observation": lidar, "simulation_frequency": 10, "policy_frequency": 10}
    environment = merge_clusters.bare_merge(options)
    observation, _ = environment.reset(seed=284)
    ego, before = environment.vehicle, 30.0
    begin = time.process_time()
    for _ in range(steps):
        own = [
            ego.position[0] / 370, -ego.position[1] / 4, -ego.heading, ego.speed / 30,
            (ego.speed - before) / 0.5, -ego.action["steering"],
        ]  # fmt: skip
        rays = observation[-np.arange(240), 0] + np.sqrt(0.004) * rng.standard_normal(240)
        before = ego.speed
        action = network(np.concatenate([own, np.clip(rays, 0.0, 1.0)])[None])[0]
        observation, *_ = environment.step(action * (1.0, -1.0))
    return time.process_time() - begin


def _parts(loop: Any, steps: int, rng: np.random.Generator) -> float:
    """Time the plugin's own road and lidar in a bare loop: no snapshots, no signals, no monitor."""
    simulator, network = loop.simulator, loop.controller.network
    environment, scene = simulator.environment, simulator.scene
    environment.reset(seed=284)
    begin = time.process_time()
    for _ in range(steps):
        row = np.array([read(environment, simulator.setting.capacity, 370.0, simulator.dt)])
        ego, others = Vehicles(*row.T[:5]), others_of(row)
        seen = simulator.sensors.observe(
            ego, row[:, 5], others, scene.lengths, scene.widths, rng.standard_normal((1, 240))
        )
        environment.action_type.act(network(seen.observation)[0] * (1.0, -1.0))
        environment.road.act()
        environment.road.step(simulator.dt)
    return time.process_time() - begin


def _within(problem: Any, loop: Any, tapes: Any, steps: int) -> float:
    """Time the same with snapshots, signals and the formula's monitor."""
    monitor = problem.monitors[0]
    state, watch = loop.initial(tapes[:, 0]), monitor.start(len(tapes))
    begin = time.process_time()
    for t in range(1, steps + 1):
        state = loop.step(state, tapes[:, t])
        watch, _ = monitor.update(watch, loop.signals(state))
    return (time.process_time() - begin) / len(tapes)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("what", choices=["heldout", "overhead", "clusters"])
    parser.add_argument("--runs", type=int, default=400, help="of heldout")
    parser.add_argument("--run", type=Path, default=Path(), help="folder with the failures of clusters")
    parser.add_argument("--pictures", type=Path, default=Path(), help="folder that clusters draws into")
    given = parser.parse_args()
    match given.what:
        case "heldout":
            heldout(given.runs)
        case "overhead":
            overhead()
        case "clusters":
            merge_clusters.draw(SCENARIO, given.run, given.pictures)


if __name__ == "__main__":
    main()
