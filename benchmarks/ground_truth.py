"""The failure probabilities of a scenario from many Monte Carlo rollouts, to measure estimators against.

    OMP_NUM_THREADS=1 python benchmarks/ground_truth.py [SCENARIO] [--rollouts 1000000] [--workers 2]
        [--seconds 3600] [--set KEY=VALUE]

Every chunk of rollouts is saved in the results folder, so the command may be stopped at any moment (Ctrl-C,
kill, or by itself after `--seconds`) and started again, with any number of workers, until it is done. Then it
writes docs/ground-truth/SCENARIO-FINGERPRINT.json, the counts and the system that they belong to, and beside
it the `.npz` with the robustness of the least robust thousandth of each rule (`studies/truth.py`). The
probabilities hold for any estimator of the same system.
"""

from __future__ import annotations

import argparse
import resource
import shlex
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from studies import truth

from avrare.base.errors import Interrupted
from avrare.estimation.loop.checkpoint import Checkpoint
from avrare.estimation.loop.loop import run
from avrare.estimation.monte_carlo.config import McConfig
from avrare.estimation.monte_carlo.monte_carlo import MonteCarlo
from avrare.estimation.plan.plan import Info, Settings
from avrare.protocols import Floats
from avrare.rollout.executors.work import build_executor
from avrare.rollout.loaded_scenario import LoadedScenario
from avrare.rollout.request import Rollouts
from avrare.scenario.fingerprint import fingerprint
from avrare.scenario.load import load
from avrare.scenario.schema import Scenario

ROOT = Path(__file__).resolve().parent.parent
RESULTS = ROOT / "benchmarks" / "results"
TRUTHS = ROOT / "docs" / "ground-truth"
KEPT = ("specification", "probability", "interval", "confidence", "rollouts", "failures", "errors", "health")


class KeepingMonteCarlo(MonteCarlo):
    """Monte Carlo that keeps the robustness of every rollout; a result has that of the first ones only.

    Attributes:
        robustness: Parts (n, S), NaN for errors.
    """

    def __init__(self, config: McConfig) -> None:
        super().__init__(config)
        self.robustness: list[Floats] = []

    def tell(self, state: Any, rollouts: Rollouts) -> tuple[Any, Info]:
        """Keep the robustness, and count."""
        self.robustness.append(np.where(rollouts.error[:, None], np.nan, rollouts.robustness))
        return super().tell(state, rollouts)


def main() -> None:
    """Run what is missing; write the truth once it is complete."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("scenario", nargs="?", default="scenarios/lane_change.yaml")
    parser.add_argument("--rollouts", type=int, default=1_000_000)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--seconds", type=float, default=float("inf"), help="stop then, after one chunk")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE")
    parser.add_argument("--results", type=Path, default=RESULTS)
    parser.add_argument("--truths", type=Path, default=TRUTHS)
    args = parser.parse_args()
    settings = [*args.set, "estimator={plugin: mc}", f"estimator.rollouts={args.rollouts}"]
    scenario = LoadedScenario(load(args.scenario, settings))
    try:
        results, robustness = rolled_out(scenario, args)
    except Interrupted:
        print("stopped, the finished chunks are saved; the same command goes on")
        return
    definition, entries = scenario.definition, [result.to_dict() for result in results]
    about = {
        "scenario": definition.name,
        **describe_system(definition),
        "fingerprint": fingerprint(definition),
        "seed": definition.seed,
        "command": shlex.join(["python", "benchmarks/ground_truth.py", *sys.argv[1:]]),
        "estimates": [{name: entry[name] for name in KEPT} for entry in entries],
    }
    file = args.truths / f"{definition.name}-{about['fingerprint']}.json"
    names = [result.specification for result in results]
    truth.write(file, about, dict(zip(names, map(truth.Tail.of, robustness.T), strict=True)))
    peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024
    print(f"{file} written; {results[0].seconds:.0f} s, the largest process had {peak:.0f} MiB")


def describe_system(definition: Scenario) -> dict[str, Any]:
    """Return the blocks that decide a rollout, and the versions of their plugins."""
    hidden = ("estimator", "seed", "chunk")
    system = {name: block for name, block in definition.resolved.items() if name not in hidden}
    return {"system": system, "versions": definition.versions}


def rolled_out(scenario: LoadedScenario, args: Any) -> tuple[list[Any], Floats]:
    """Return the results of all rollouts and their robustness (N, S), those of earlier calls included."""
    definition = scenario.definition
    folder = args.results / f"ground_truth_{definition.name}_{fingerprint(definition)}"
    problem = scenario.problem(scenario.specifications)
    executor = build_executor(args.workers)
    settings = Settings(definition.seed, definition.confidence)
    began, told, moved = time.monotonic(), [time.monotonic()], [False]

    def tell(info: Info) -> None:
        moved[0] = True  # before that, nothing is saved that the next call could go on with
        if time.monotonic() - told[0] > 60.0:
            told[0] = time.monotonic()
            print(f"{info.rollouts} of {args.rollouts} rollouts, {info.failures} failures", flush=True)

    task = {"scenario": definition.resolved | {"estimator": None}, "versions": definition.versions}
    estimator = KeepingMonteCarlo(McConfig(rollouts=args.rollouts))
    with Checkpoint.open(folder, task).hold() as checkpoint:
        results = run(
            problem, estimator, executor, settings, tell,
            checkpoint.journal("rollouts"), lambda: moved[0] and time.monotonic() - began > args.seconds,
        )  # fmt: skip
    return results, np.concatenate(estimator.robustness)


if __name__ == "__main__":
    main()
