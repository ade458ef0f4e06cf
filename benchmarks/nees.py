"""Consistency of the tracker's errors with its covariances, for docs/concepts/tracker.md.

    OMP_NUM_THREADS=1 python benchmarks/nees.py [--scenario scenarios/lane_change.yaml] [--rollouts 200]

Drives the closed loop with several trackers and perception error models. Of each vehicle: the normalised
estimation error squared (NEES) of position and of velocity, which has a mean of 2 where the
covariance is right, the root mean square error of the position, the share of steps with a track, and the
first step with one.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from avrare.rollout.engine import simulate
from avrare.rollout.loaded_scenario import LoadedScenario
from avrare.rollout.noise import NoiseSource
from avrare.rollout.request import Request
from avrare.scenario.load import load

_ANEW, _LASTING = "perception.persistence={}", "perception.persistence=measured"
_PLAIN = ("tracker.gate=null", "tracker.death=null", "tracker.velocity=noisy")
_FULL = ("tracker.gate=4", "tracker.death=10", "tracker.velocity=none")
_WIDER = ("tracker.position_variance=0.25", "tracker.lateral_variance=0.25")
SETTINGS = {
    "defaults, drawn anew": (_ANEW, *_PLAIN),
    "defaults, measured persistence": (_LASTING, *_PLAIN),
    "gate, drawn anew": (_ANEW, *_PLAIN, "tracker.gate=4"),
    "gate, measured persistence": (_LASTING, *_PLAIN, "tracker.gate=4"),
    "gate, death, positions only, drawn anew": (_ANEW, *_FULL),
    "gate, death, positions only, measured persistence": (_LASTING, *_FULL),
    "the same, empty start": (_LASTING, *_FULL, "tracker.start=empty"),
    "the same, variances 0.25": (_LASTING, *_FULL, *_WIDER),
}
"""Overrides of the scenario, by name."""
CHUNK = 100


@dataclass(frozen=True)
class Errors:
    """Errors of the tracks, fields (N, steps, V); NaN where there is no track.

    Attributes:
        position_nees: Of x and y.
        velocity_nees: Of the velocities along and across the road.
        distance: Error of the position [m].
    """

    position_nees: NDArray[np.float64]
    velocity_nees: NDArray[np.float64]
    distance: NDArray[np.float64]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--scenario", default="scenarios/lane_change.yaml")
    parser.add_argument("--rollouts", type=int, default=200)
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="for all settings")
    parser.add_argument("--only", action="append", help="name of a setting; may be repeated")
    args = parser.parse_args()
    for name in args.only or SETTINGS:
        scenario = LoadedScenario(
            load(args.scenario, ["perception.model=measured", *args.set, *SETTINGS[name]])
        )
        print(name)
        for line in describe(drive(scenario, args.rollouts), scenario.stack.scene.names):
            print(f"  {line}", flush=True)


def drive(scenario: LoadedScenario, rollouts: int) -> Errors:
    """Drive all rollouts and compare tracks with the truth."""
    loop, parts = scenario.stack.loop, []
    specifications = tuple(scenario.stack.specifications.values())
    for begin in range(0, rollouts, CHUNK):
        index = np.arange(begin, min(begin + CHUNK, rollouts))
        request = Request.from_start(np.zeros_like(index), index, keep_carries=True)
        noise = NoiseSource(1, loop.noise_size)
        found = simulate(loop, specifications, scenario.steps, noise, request, scored=False)
        states = [carry.system for t, rows, carry in found.carries if t > 0 and len(rows) == len(index)]
        parts.append([compare(loop.tracker, state) for state in states])
    each = range(len(parts[0][0]))
    stacked = [np.concatenate([np.stack([step[i] for step in part], axis=1) for part in parts]) for i in each]
    return Errors(*stacked)


def compare(tracker: object, state: object) -> Sequence[NDArray[np.float64]]:
    """Return NEES of position and velocity and the error of position of one step, each (N, V)."""
    now, others = tracker.estimate(state.track), state.world.others  # type: ignore[attr-defined]
    along, across = now.longitudinal_covariance, now.lateral_covariance
    x, y = now.x - others.x, now.y - others.y
    vx = now.vx - others.speed * np.cos(others.heading)
    vy = now.vy - others.speed * np.sin(others.heading)
    position = x**2 / along[..., 0, 0] + y**2 / across[..., 0, 0]
    velocity = vx**2 / along[..., 1, 1] + vy**2 / across[..., 1, 1]
    known = np.where(now.exists, 0.0, np.nan)
    return position + known, velocity + known, np.hypot(x, y) + known


def describe(errors: Errors, names: tuple[str, ...]) -> list[str]:
    """Return a line for each vehicle."""
    lines = []
    for v, name in enumerate(names):
        position, velocity, distance = (part[:, :, v] for part in vars(errors).values())
        tracked = ~np.isnan(position)
        lines.append(
            f"{name}: NEES position {np.nanmean(position):.1f} (median {np.nanmedian(position):.1f}), "
            f"velocity {np.nanmean(velocity):.1f} (median {np.nanmedian(velocity):.1f}), "
            f"position error {np.sqrt(np.nanmean(distance**2)):.2f} m, "
            f"tracked {tracked.mean():.1%}, first at {first_step(tracked):.1f} steps"
        )
    return lines


def first_step(tracked: NDArray[np.bool_]) -> float:
    """Return the mean first step (from 1) with a track, of rollouts that have one."""
    some = tracked.any(axis=1)
    return float(tracked[some].argmax(axis=1).mean() + 1) if some.any() else float("nan")


if __name__ == "__main__":
    main()
