"""Levels at which a scene is driven: accelerations, jerk, time to collision, of one drive and over many.

    OMP_NUM_THREADS=1 python benchmarks/lane_change_levels.py [SCENARIO] [--rollouts 1000] [--set KEY=VALUE]
        [--rules]

Prints the tables of docs/lane-change.md. Peaks are over the samples of a rollout; a quantile is over rollouts
of the peak (of the time to collision: of the least value). `--rules` adds the failures of each rule and
quantiles of its robustness.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from avrare.rollout.loaded_scenario import LoadedScenario
from avrare.rollout.noise import NoiseSource
from avrare.rollout.problem import Problem
from avrare.scenario.load import load

Floats = NDArray[np.float64]
GRAVITY = 9.81
LEVELS = {
    "lateral acceleration [m/s^2]": "lateral_acceleration",
    "braking [m/s^2]": "braking",
    "combined acceleration [g]": "combined_g",
    "jerk [m/s^3]": "jerk",
    "time to collision [s]": "time_to_collision",
    "gap [m]": "gap",
}
LEAST = ("time_to_collision", "gap")
"""Levels of which the least value of a rollout counts, not the peak."""
QUANTILES = (0.5, 0.9, 0.99, 0.999)


@dataclass(frozen=True)
class Drives:
    """Rollouts.

    Attributes:
        levels: Least or peak value of each level (N,).
        start: Time to collision at the start (N,) [s].
        robustness: (N, rules).
        violated: (N, rules).
        counts: Sums of the counters.
    """

    levels: dict[str, Floats]
    start: Floats
    robustness: Floats
    violated: NDArray[np.bool_]
    counts: dict[str, int]


def drive(problem: Problem, tapes: Floats) -> Drives:
    """Drive noise tapes (N, steps + 1, noise_size) and keep their levels."""
    system: Any = problem.system
    state = system.initial(tapes[:, 0])
    signals = system.signals(state)
    start, levels = signals["time_to_collision"], _levels(signals)
    updates = [spec.update(spec.start(len(tapes)), signals) for spec in problem.monitors]
    for t in range(1, problem.steps + 1):
        state = system.step(state, tapes[:, t])
        signals = system.signals(state)
        now = _levels(signals)
        levels = {name: _worse(name)(values, now[name]) for name, values in levels.items()}
        pairs = zip(problem.monitors, updates, strict=True)
        updates = [spec.update(monitor, signals) for spec, (monitor, _) in pairs]
    robustness = np.stack([verdict.robustness for _, verdict in updates], axis=1)
    violated = np.stack([verdict.violated for _, verdict in updates], axis=1)
    counts = {name: int(values.sum()) for name, values in system.counts(state).items()}
    return Drives(levels, start, robustness, violated, counts)


def drive_many(problem: Problem, rollouts: int, seed: int) -> Drives:
    """Drive the first rollouts of a seed, those of `avrare run` with Monte Carlo."""
    noise, parts = NoiseSource(seed, problem.noise_size), []
    for first in range(0, rollouts, problem.chunk):
        particle = np.arange(first, min(first + problem.chunk, rollouts))[:, None]
        zeros = np.zeros_like(particle)
        parts.append(drive(problem, noise.normals(zeros, zeros, particle, np.arange(problem.steps + 1))))
    return Drives(
        {name: np.concatenate([part.levels[name] for part in parts]) for name in parts[0].levels},
        *(
            np.concatenate([getattr(part, name) for part in parts])
            for name in ("start", "robustness", "violated")
        ),
        {name: sum(part.counts[name] for part in parts) for name in parts[0].counts},
    )


def _levels(signals: Any) -> dict[str, Floats]:
    return {
        "lateral_acceleration": np.abs(signals["lateral_acceleration"]),
        "braking": np.maximum(-signals["longitudinal_acceleration"], 0.0),
        "combined_g": signals["combined_acceleration"] / GRAVITY,
        **{name: signals[name] for name in ("jerk", *LEAST)},
    }


def _worse(name: str) -> Any:
    return np.minimum if name in LEAST else np.maximum


def level_table(nominal: Drives, many: Drives) -> list[str]:
    """Return a Markdown table: the noise-free drive, and quantiles of the others."""
    head = [f"{q:.1%}".replace(".0%", "%").replace("%", " %") for q in QUANTILES]
    lines = ["| | noise-free | " + " | ".join(head) + " | worst |", "|---" * (len(QUANTILES) + 3) + "|"]
    for label, name in LEVELS.items():
        least = name in LEAST
        values = many.levels[name]
        shown = [np.quantile(values, 1.0 - q if least else q) for q in QUANTILES]
        cells = [nominal.levels[name][0], *shown, values.min() if least else values.max()]
        lines.append(f"| {label} | " + " | ".join(f"{cell:.3g}" for cell in cells) + " |")
    return lines


def rule_table(names: tuple[str, ...], nominal: Drives, many: Drives) -> list[str]:
    """Return a Markdown table of failures and robustness."""
    shown = (0.0, 0.001, 0.01, 0.05, 0.5)
    lines = ["| | failures | noise-free | " + " | ".join(f"{q:.1%}" for q in shown) + " |", "|---" * 8 + "|"]
    for column, name in enumerate(names):
        values = np.quantile(many.robustness[:, column], shown, method="lower")
        cells = [nominal.robustness[0, column], *values]
        count = int(many.violated[:, column].sum())
        lines.append(f"| {name} | {count} | " + " | ".join(f"{cell:.3g}" for cell in cells) + " |")
    return lines


def main() -> None:
    """Drive and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("scenario", nargs="?", default="scenarios/lane_change.yaml")
    parser.add_argument("--rollouts", type=int, default=1000)
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE")
    parser.add_argument("--rules", action="store_true")
    args = parser.parse_args()
    scenario = LoadedScenario(load(args.scenario, args.set))
    problem = scenario.problem(scenario.specifications)
    nominal = drive(problem, np.zeros((1, problem.steps + 1, problem.noise_size)))
    many = drive_many(problem, args.rollouts, scenario.definition.seed)
    print(f"{scenario.name}: {args.rollouts} rollouts, seed {scenario.definition.seed}, {many.counts}")
    print(f"time to collision at the start {nominal.start[0]:.2f} s")
    print("\n".join(level_table(nominal, many)))
    print(f"above 1 g: {int((many.levels['combined_g'] > 1.0).sum())} of {args.rollouts}")
    if args.rules:
        print("\n".join(rule_table(problem.names, nominal, many)))


if __name__ == "__main__":
    main()
