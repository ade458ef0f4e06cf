"""Study of how failure probabilities depend on the size of the detector's errors, on the same noise tapes.

    OMP_NUM_THREADS=1 python benchmarks/detector_errors.py [SCENARIO] [--rollouts 10000] [--misses]
        [--factors 0.05,0.25,0.5,1,2,3] [--results FOLDER]

Every error of position is multiplied by a factor (with `--misses`: the probability of every miss instead, up
to 1); all else stays, the tracker's variances among it. Prints the table of docs/lane-change.md. Counts of
finished factors are kept in the results folder, and not computed again.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
from lane_change_levels import drive_many

from avrare.driving import World
from avrare.protocols.adapter import Adapted
from avrare.rollout.loaded_scenario import LoadedScenario
from avrare.rollout.problem import Problem
from avrare.scenario.fingerprint import fingerprint
from avrare.scenario.load import load
from avrare.stack.closed_loop import ClosedLoop
from avrare_gp_pem.runtime.models import LawPem
from avrare_gp_pem.runtime.observation_model import ObservationLaw
from avrare_gp_pem.runtime.persistence import PersistentPem

RESULTS = Path(__file__).resolve().parent / "results" / "detector_errors"
FACTORS = "0.05,0.25,0.5,1,2,3"


@dataclasses.dataclass(frozen=True)
class ScaledPem(LawPem):
    """Perception error model with errors and misses that are so many times those of another."""

    model: Any
    scene: Any
    errors: float = 1.0
    misses: float = 1.0

    def law(self, world: World) -> ObservationLaw:
        """Return the distribution of the observation of ``world``."""
        law = self.model.law(world)
        miss = np.minimum(self.misses * law.miss, 1.0)
        return dataclasses.replace(  # type: ignore[no-any-return]
            law,
            detect=law.detect if self.misses == 1.0 else 1.0 - miss,
            miss=miss,
            location=self.errors * law.location,
            scale=self.errors * law.scale,
            limit=self.errors * law.limit,
        )


def scaled(model: Any, scene: Any, **factors: float) -> Any:
    """Scale a perception error model, whether its errors persist or not."""
    if isinstance(model, Adapted):
        model = model.part
    if isinstance(model, PersistentPem):
        return dataclasses.replace(model, memoryless=ScaledPem(model.memoryless, scene, **factors))
    return ScaledPem(model, scene, **factors)


def scaled_problem(scenario: LoadedScenario, **factors: float) -> Problem:
    """Return the scenario's problem with scaled errors."""
    loop, problem = scenario.stack.loop, scenario.problem(scenario.specifications)
    perception = scaled(loop.perception, scenario.scene, **factors)
    problem.system = ClosedLoop(loop.simulator, perception, loop.tracker, loop.controller, loop.start)
    return problem


def failures(path: str, settings: list[str], rollouts: int, **factors: float) -> dict[str, int]:
    """Count the failures of each rule."""
    scenario = LoadedScenario(load(path, settings))
    problem = scaled_problem(scenario, **factors)
    violated = drive_many(problem, rollouts, scenario.definition.seed).violated
    return dict(zip(problem.names, violated.sum(axis=0).tolist(), strict=True))


def table(counts: dict[str, dict[str, int]], head: str) -> str:
    """Return a Markdown table, a row for each rule."""
    lines = [f"| {head} | " + " | ".join(counts) + " |", "|---" * (len(counts) + 1) + "|"]
    for rule in next(iter(counts.values())):
        lines.append(f"| {rule} | " + " | ".join(str(each[rule]) for each in counts.values()) + " |")
    return "\n".join(lines)


def main() -> None:
    """Count what is missing, and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("scenario", nargs="?", default="scenarios/lane_change.yaml")
    parser.add_argument("--rollouts", type=int, default=10_000)
    parser.add_argument("--factors", default=FACTORS)
    parser.add_argument("--misses", action="store_true")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE")
    parser.add_argument("--results", type=Path, default=RESULTS)
    args = parser.parse_args()
    which = "misses" if args.misses else "errors"
    digest = fingerprint(LoadedScenario(load(args.scenario, args.set)).definition)
    args.results.mkdir(parents=True, exist_ok=True)
    counts = {}
    for factor in args.factors.split(","):
        file = args.results / f"{digest}-{which}-{factor}-{args.rollouts}.json"
        if not file.exists():
            found = failures(args.scenario, args.set, args.rollouts, **{which: float(factor)})
            file.write_text(json.dumps(found), encoding="utf-8")
        counts[factor] = json.loads(file.read_text(encoding="utf-8"))
        print(f"{which} x {factor}: {counts[factor]}", flush=True)
    print(table(counts, f"{args.rollouts} rollouts, {which} times"))


if __name__ == "__main__":
    main()
