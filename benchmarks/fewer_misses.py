"""Study of a detector that misses less often and fails more often on the lane change, on paired noise tapes.

    OMP_NUM_THREADS=1 python benchmarks/fewer_misses.py [--rollouts 1000]

The first tapes of seed 0 are driven with the detector's own misses and with half of them. Those that break
R_G1 either way are then driven with half the misses of one vehicle only, beyond 60 m only, or with another
tracker; and the track of `cut_in` is followed in drives that only fewer misses break. Prints the tables of
docs/study-lane-change.md.
"""

from __future__ import annotations

import argparse
import dataclasses
from typing import Any

import numpy as np
from detector_errors import scaled_problem
from lane_change_levels import drive_many

from avrare.driving import World
from avrare.protocols import Floats
from avrare.rollout.loaded_scenario import LoadedScenario
from avrare.rollout.noise import NoiseSource
from avrare.rollout.problem import Problem
from avrare.rollout.replay import replay_tapes
from avrare.scenario.load import load
from avrare.stack.closed_loop import ClosedLoop
from avrare_gp_pem.runtime.models import LawPem
from avrare_gp_pem.runtime.observation_model import ObservationLaw

SCENARIO, HALF, FAR, FOLLOWED = "scenarios/lane_change.yaml", 0.5, 60.0, 30
TRACKERS = {
    "as it is": [],
    "no gate": ["tracker.gate=null"],
    "death after 5 misses": ["tracker.death=5"],
    "variances 1 m^2": ["tracker.position_variance=1.0", "tracker.lateral_variance=1.0"],
}
TIMES = (1.2, 2.0, 2.8, 3.6, 4.4)


@dataclasses.dataclass(frozen=True)
class PartlyPem(LawPem):
    """Perception error model whose misses are halved for one vehicle, within some ranges."""

    model: Any
    scene: Any
    vehicle: str
    nearest: float = 0.0
    farthest: float = np.inf

    def law(self, world: World) -> ObservationLaw:
        """Return the distribution of the observation of ``world``."""
        law = self.model.law(world)
        apart = np.hypot(world.others.x - world.ego.x[:, None], world.others.y - world.ego.y[:, None])
        chosen = (
            (np.array(self.scene.names) == self.vehicle) & (apart >= self.nearest) & (apart < self.farthest)
        )
        miss = np.where(chosen, HALF * law.miss, law.miss)
        detect = np.where(chosen, 1.0 - miss, law.detect)
        return dataclasses.replace(law, detect=detect, miss=miss)  # type: ignore[no-any-return]


def partly(scenario: LoadedScenario, **where: Any) -> Problem:
    """Return the scenario's problem with half the misses of one vehicle."""
    loop, problem = scenario.stack.loop, scenario.problem(scenario.specifications)
    model: Any = loop.perception
    part = PartlyPem(model.memoryless, scenario.scene, **where)
    perception = dataclasses.replace(model, memoryless=part)
    problem.system = ClosedLoop(loop.simulator, perception, loop.tracker, loop.controller, loop.start)
    return problem


def tapes_of(problem: Problem, rows: Any) -> Floats:
    """Return the tapes of some rollouts of seed 0."""
    particle = np.asarray(rows)[:, None]
    zeros = np.zeros_like(particle)
    return NoiseSource(0, problem.noise_size).normals(zeros, zeros, particle, np.arange(problem.steps + 1))


def follow(scenario: Any, problem: Problem, rows: Any) -> dict[str, Floats]:
    """Return (R, T) errors and existence of the track of `cut_in`, and the ego's offset."""
    tracker, v = scenario.stack.loop.tracker, scenario.scene.names.index("cut_in")
    found: dict[str, list[list[float]]] = {"place": [], "speed": [], "exists": [], "ego y": []}
    for rollout in replay_tapes(problem, tapes_of(problem, rows)):
        tracks = [tracker.estimate(state.track) for state in rollout.states]
        others = [state.world.others for state in rollout.states]
        pairs = list(zip(tracks, others, strict=True))
        found["place"].append([float(track.x[0, v] - true.x[0, v]) for track, true in pairs])
        found["speed"].append([float(track.vx[0, v] - true.speed[0, v]) for track, true in pairs])
        found["exists"].append([float(track.exists[0, v]) for track in tracks])
        found["ego y"].append([float(state.world.ego.y[0]) for state in rollout.states])
    return {name: np.array(values) for name, values in found.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--rollouts", type=int, default=1000)
    count = parser.parse_args().rollouts
    scenario: Any = LoadedScenario(load(SCENARIO, ["chunk=500"]))
    own = drive_many(scaled_problem(scenario), count, 0).violated[:, 0]
    half = drive_many(scaled_problem(scenario, misses=HALF), count, 0).violated[:, 0]
    rows = np.flatnonzero(own | half)
    print(f"{count} tapes: {own.sum()} break R_G1 as it is, {half.sum()} with half the misses")
    print(f"{(half & ~own).sum()} only then, {(own & ~half).sum()} only as it is")
    cases = [{"vehicle": name} for name in scenario.scene.names]
    cases += [{"vehicle": "cut_in", "nearest": FAR}, {"vehicle": "cut_in", "farthest": FAR}]
    for where in cases:
        problem = partly(scenario, **where)
        failing = problem.replay(tapes_of(problem, rows)).violated[:, 0].sum()
        print(f"half the misses of {where}: {failing} of these {len(rows)}")
    for name, settings in TRACKERS.items():
        other = LoadedScenario(load(SCENARIO, ["chunk=500", *settings]))
        problems = [scaled_problem(other, misses=factor) for factor in (1.0, HALF)]
        failing = [problem.replay(tapes_of(problem, rows)).violated[:, 0].sum() for problem in problems]
        print(f"tracker {name}: {failing[0]} as it is, {failing[1]} with half the misses")
    chosen = np.flatnonzero(half & ~own)[:FOLLOWED]
    for factor in (1.0, HALF) if len(chosen) else ():
        found = follow(scenario, scaled_problem(scenario, misses=factor), chosen)
        print(f"misses x {factor}, medians of {len(chosen)} drives that only half the misses break:")
        for time in TIMES:
            t = round(time / scenario.scene.dt)
            middle = ", ".join(f"{name} {np.median(values[:, t]):+.2f}" for name, values in found.items())
            print(f"  {time} s: {middle}")


if __name__ == "__main__":
    main()
