"""Drives of a scene checked by other means: the ego's motion and limits, contacts, consistency of tracks.

    OMP_NUM_THREADS=1 python benchmarks/drive_physics.py [SCENARIO] [--rollouts 1000] [--seed 21]
        [--set KEY=VALUE]

The motion is integrated anew, in `PARTS` midpoint steps a sample, from speeds and steering angles at the
samples. Contacts are looked for at as many poses between two samples, by lines that separate the boxes. The
consistency of tracks is the normalised square of the error of their position (NEES), 2 in the mean where the
tracker knows its errors.
"""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np

from avrare.protocols import Bools, Floats
from avrare.rollout.loaded_scenario import LoadedScenario
from avrare.rollout.noise import NoiseSource
from avrare.scenario.load import load

PARTS = 40
NEAR_METRES = 12.0
"""Distance of centres beyond which no two vehicles touch within a sample."""
GRAVITY = 9.81
CHI_SQUARE_99 = 9.21
"""What a normal error with the tracker's covariance exceeds once in a hundred times, in two dimensions."""


class Extremes:
    """Greatest values by name, over all samples of all drives."""

    def __init__(self) -> None:
        self.values: dict[str, float] = {}

    def note(self, name: str, values: Floats) -> None:
        """Keep the greatest of the values, and of those before."""
        self.values[name] = max(self.values.get(name, 0.0), float(np.max(values, initial=0.0)))


def integrate(before: Any, after: Any, wheelbase: float, dt: float) -> tuple[Floats, Floats, Floats]:
    """Return x, y and heading (N,) after a sample, from speeds and steering angles at both of its ends."""
    x, y, heading = (getattr(before.ego, name).copy() for name in ("x", "y", "heading"))
    for part in range(PARTS):
        share, time = (part + 0.5) / PARTS, dt / PARTS
        speed = before.ego.speed + share * (after.ego.speed - before.ego.speed)
        angle = before.steering + share * (after.steering - before.steering)
        slip = np.arctan(0.5 * np.tan(angle))
        turn = speed * np.cos(slip) * np.tan(angle) / wheelbase
        course = heading + 0.5 * time * turn + slip
        x, y = x + time * speed * np.cos(course), y + time * speed * np.sin(course)
        heading = heading + time * turn
    return x, y, heading


def corners(x: Floats, y: Floats, heading: Floats, length: float, width: float) -> Floats:
    """Return corners (..., 4, 2) of rectangles, in their order around it."""
    along = 0.5 * length * np.array([1, -1, -1, 1])
    across = 0.5 * width * np.array([1, 1, -1, -1])
    cos, sin = np.cos(heading)[..., None], np.sin(heading)[..., None]
    return np.stack(
        [x[..., None] + along * cos - across * sin, y[..., None] + along * sin + across * cos], -1
    )


def overlap(first: Floats, second: Floats) -> Bools:
    """Return whether convex shapes (..., 4, 2) overlap: no edge of either separates them."""
    apart = np.zeros(first.shape[:-2], dtype=bool)
    for shape in (first, second):
        for edge in range(4):
            side = shape[..., (edge + 1) % 4, :] - shape[..., edge, :]
            normal = np.stack([-side[..., 1], side[..., 0]], axis=-1)[..., None, :]
            own, other = ((normal * each).sum(-1) for each in (first, second))
            apart |= (own.max(-1) < other.min(-1)) | (other.max(-1) < own.min(-1))
    return ~apart


def touches(before: Any, after: Any, scene: Any) -> Bools:
    """Return whether (N,) the ego touches a vehicle at one of the poses between two samples."""
    ego, others = after.ego, after.others
    hit = np.zeros(len(ego.x), dtype=bool)
    near = np.hypot(others.x - ego.x[:, None], others.y - ego.y[:, None]) < NEAR_METRES
    for car in range(len(scene.names)):
        rows = np.flatnonzero(near[:, car])
        for share in np.linspace(0.0, 1.0, PARTS + 1):
            own = poses(before.ego, after.ego, share, rows)
            other = poses(before.others, after.others, share, (rows, car))
            sizes = (scene.ego_length, scene.ego_width), (scene.lengths[car], scene.widths[car])
            hit[rows] |= overlap(corners(*own, *sizes[0]), corners(*other, *sizes[1]))
    return hit


def poses(old: Any, new: Any, share: float, rows: Any) -> tuple[Floats, ...]:
    """Return x, y and heading of rows at a share of the way between two samples."""
    pairs = ((getattr(old, name)[rows], getattr(new, name)[rows]) for name in ("x", "y", "heading"))
    return tuple(first + share * (second - first) for first, second in pairs)


def position_nees(track: Any, others: Any) -> Floats:
    """Return the normalised squared error of position (N, V) of fused tracks; NaN: no track."""
    along = (others.x - track.x) ** 2 / track.longitudinal_covariance[..., 0, 0]
    across = (others.y - track.y) ** 2 / track.lateral_covariance[..., 0, 0]
    return np.where(track.exists, along + across, np.nan)


def main() -> None:
    """Drive and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("scenario", nargs="?", default="scenarios/lane_change.yaml")
    parser.add_argument("--rollouts", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=21)
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE")
    args = parser.parse_args()
    scenario = LoadedScenario(load(args.scenario, args.set))
    problem = scenario.problem("no_collision")
    loop, scene, rule = problem.system, scenario.stack.scene, problem.monitors[0]
    config, dt = loop.simulator.config.ego, loop.simulator.dt
    noise, extremes = NoiseSource(args.seed, problem.noise_size), Extremes()
    nees: list[Floats] = []
    collisions = missed = 0
    for first in range(0, args.rollouts, problem.chunk):
        particle = np.arange(first, min(first + problem.chunk, args.rollouts))
        zeros = np.zeros_like(particle)
        state = loop.initial(noise.normals(zeros, zeros, particle, zeros))
        monitor, verdict = rule.update(rule.start(len(particle)), loop.signals(state))
        touched = np.zeros(len(particle), dtype=bool)
        for t in range(1, problem.steps + 1):
            before, state = state.world, loop.step(state, noise.normals(zeros, zeros, particle, zeros + t))
            monitor, verdict = rule.update(monitor, loop.signals(state))
            after, drives = state.world, ~state.world.ended
            touched |= touches(before, after, scene)
            x, y, heading = integrate(before, after, config.wheelbase, dt)
            extremes.note("position [m]", np.hypot(x - after.ego.x, y - after.ego.y)[drives])
            extremes.note("heading [rad]", np.abs(heading - after.ego.heading)[drives])
            change = (after.ego.speed - before.ego.speed) / dt
            extremes.note(
                "acceleration against speeds [m/s2]", np.abs(change - after.ego.acceleration)[drives]
            )
            extremes.note("steering rate [rad/s]", np.abs(after.steering - before.steering)[drives] / dt)
            slip = np.arctan(0.5 * np.tan(after.steering))
            across = after.ego.speed**2 * np.cos(slip) * np.tan(after.steering) / config.wheelbase
            held = np.hypot(change, across) / (after.friction * GRAVITY)
            extremes.note("demand over grip [-]", held[drives])
            squares = position_nees(loop.tracker.estimate(state.track), after.others)
            nees.append(np.where(drives[:, None], squares, np.nan))
        collisions += int(verdict.violated.sum())
        missed += int((touched & ~verdict.violated).sum())
    print(f"{scenario.name}: {args.rollouts} drives, seed {args.seed}; greatest differences and demands")
    for name, value in extremes.values.items():
        print(f"  {name:36s} {value:.2g}")
    print(f"  collisions {collisions}, contacts between samples that no collision tells {missed}")
    errors = np.concatenate(nees).T
    for name, squares in zip(("all", *scene.names), (errors, *errors), strict=True):
        known = squares[np.isfinite(squares)]
        mean, median, beyond = known.mean(), np.median(known), (known > CHI_SQUARE_99).mean()
        print(
            f"  NEES of {name:7s} mean {mean:.2f}, median {median:.2f}, above {CHI_SQUARE_99}: {beyond:.1%}"
        )


if __name__ == "__main__":
    main()
