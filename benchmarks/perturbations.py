"""Failures of a scene after one change at a time, on the same noise.

    OMP_NUM_THREADS=1 python benchmarks/perturbations.py [SCENARIO] [--rollouts 1000] [--seed 21]
        [--only NAME ...] [--set KEY=VALUE]

Prints the table of docs/lane-change.md: failures of each rule, with each entry of `CHANGES` in turn.
"""

from __future__ import annotations

import argparse

import numpy as np
from numpy.typing import NDArray

from avrare.rollout.loaded_scenario import LoadedScenario
from avrare.rollout.noise import NoiseSource
from avrare.rollout.request import Request
from avrare.scenario.load import load


def draw_about(option: str, value: float) -> str:
    """Return the override by which an option is drawn next to a value, and reads the tape as before."""
    return f"{option}={{law: uniform, low: {value - 1e-6}, high: {value + 1e-6}}}"


RULES = ("safe_distance", "no_abrupt_braking", "traffic_flow", "left_traffic", "no_collision")
CHANGES = {
    "as it is": [],
    "ego 10 m nearer": ["simulator.ego.x=10"],
    "ego 10 m farther": ["simulator.ego.x=-10"],
    "parked 10 m nearer": ["simulator.vehicles.0.x={law: uniform, low: 120.0, high: 180.0}"],
    "parked 10 m farther": ["simulator.vehicles.0.x={law: uniform, low: 140.0, high: 200.0}"],
    "left 10 m back": ["simulator.vehicles.1.x.mean=0"],
    "left 10 m ahead": ["simulator.vehicles.1.x.mean=20"],
    "merge 10 m back": ["simulator.vehicles.2.x.mean=-45"],
    "merge 10 m ahead": ["simulator.vehicles.2.x.mean=-25"],
    "range 140 m": ["perception.detection_range=140"],
    "range 120 m": ["perception.detection_range=120"],
    "range 100 m": ["perception.detection_range=100"],
    "range 50 m": ["perception.detection_range=50"],
    "range 40 m": ["perception.detection_range=40"],
    "range 30 m": ["perception.detection_range=30"],
    "odds of a miss x 3": ["perception.miss_scale=3"],
    "errors x 2": ["perception.error_scale=2"],
    "errors x 0.5": ["perception.error_scale=0.5"],
    "perfect perception": ["perception=null"],
    "latency of perception 0.1 s": ["timing.perception_latency=0.1"],
    "latency of perception 0.2 s": ["timing.perception_latency=0.2"],
    "latency of perception 0.3 s": ["timing.perception_latency=0.3"],
    "delay of actuation 0.1 s": ["timing.actuation_delay=0.1"],
    "delay of actuation 0.2 s": ["timing.actuation_delay=0.2"],
    "delay 0.2 s, compensated": ["timing.actuation_delay=0.2", "timing.compensated=true"],
    "lag of actuators 0.2 s": ["actuators={acceleration_lag: 0.2, turn_lag: 0.2}"],
    "power 60 W/kg": ["actuators.power_max=60"],
    "friction 0.4": [draw_about("simulator.ego.friction", 0.4)],
    "friction 0.3": [draw_about("simulator.ego.friction", 0.3)],
    "weather 1.5": [draw_about("simulator.weather", 1.5)],
    "weather 3": [draw_about("simulator.weather", 3)],
    "ghosts 0.03": [
        "perception.ghosts={rate: 0.03, persistence: 0.5, forward: [0.0, 120.0]}",
        "tracker.association=hungarian",
    ],
    "common error 0.3 m": ["perception.common={sd: [0.3, 0.3], time: 0.5}"],
    "own place 0.2 m aside": ["perception.pose={sd: [0.0, 0.2]}"],
    "blackouts": ["perception.blackouts={rate: 0.05, duration: 0.5}"],
    "half the step": ["simulator.substeps=2"],
    "start: empty": ["tracker.start=empty"],
    "start: truth": ["tracker.start=truth"],
    "aeb": ["aeb={}"],
}
"""Overrides of the scene, by the words of the table."""


def judge(file: str, settings: list[str], rollouts: int, seed: int) -> NDArray[np.bool_]:
    """Return which rules (rollouts, rules) the first rollouts of a seed violate."""
    problem = LoadedScenario(load(file, settings)).problem(RULES)
    noise, chunks = NoiseSource(seed, problem.noise_size), []
    for first in range(0, rollouts, problem.chunk):
        rows = np.arange(first, min(first + problem.chunk, rollouts))
        result = problem.simulate(noise, Request.from_start(np.zeros_like(rows), rows), scored=False)
        assert not result.error.any(), settings
        chunks.append(result.violated)
    return np.concatenate(chunks)


def main() -> None:
    """Drive and print, a line as soon as it is known."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("scenario", nargs="?", default="scenarios/lane_change.yaml")
    parser.add_argument("--rollouts", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=21)
    parser.add_argument("--only", nargs="*", default=list(CHANGES), metavar="NAME")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE")
    args = parser.parse_args()
    print(f"| failures of {args.rollouts:,} | {' | '.join(RULES)} |\n{'|---' * (len(RULES) + 1)}|")
    for name in args.only:
        violated = judge(args.scenario, [*args.set, *CHANGES[name]], args.rollouts, args.seed)
        print(f"| {name} | {' | '.join(f'{count:,}' for count in violated.sum(axis=0))} |", flush=True)


if __name__ == "__main__":
    main()
