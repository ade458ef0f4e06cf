"""Case study: MetaDrive's own driver behind 240 noisy lidar rays, by Monte Carlo, splitting and slices.

    OMP_NUM_THREADS=1 python benchmarks/metadrive_study.py estimate mc|ams|ess [--parts 10]
    OMP_NUM_THREADS=1 python benchmarks/metadrive_study.py cost
    OMP_NUM_THREADS=1 python benchmarks/metadrive_study.py picture
    python benchmarks/metadrive_study.py report

Runs in the environment of ``plugins/avrare-metadrive/README.md``. An estimate consists of parts: ``estimate``
runs those that the results folder lacks, so that a later call with more parts adds to it; ``report`` prints
the table of all. ``picture`` draws from the failing tapes (it needs matplotlib and scikit-learn).
"""

from __future__ import annotations

import argparse
import os
import time
from pathlib import Path
from typing import Any

import numpy as np
from studies import kept, metadrive_parts, metadrive_picture

import avrare
from avrare.scenario.fingerprint import fingerprint
from avrare_metadrive import world
from avrare_metadrive.config import MetaDriveConfig

ROOT = Path(__file__).parents[1]
SCENARIO = ROOT / "scenarios" / "merge_metadrive.yaml"
PICTURES = ROOT / "docs" / "metadrive"
KEPT = PICTURES / "results.zip"
LEAST_SPEED, LEAST_REWARD = 5.0, 193.5
"""Of the scenario's formula."""
PACE = 1.3
"""Most reward of a step; the arrival gives more, once."""
OPTIONS: dict[str, dict[str, Any]] = {
    "mc": {"rollouts": 50},
    "ams": {"particles": 40, "discard": 8, "runs": 1},
    "ess": {"chains": 8, "level_probability": 0.25, "runs": 1},
}
"""Of a part."""


def danger(usual: Any) -> Any:
    """Return the score that splitting orders by: -1 at full speed without delay, 0 where a failure threatens.

    How slow the last five samples are, or how far the reward lags behind ``usual`` (T + 1,), that of a run
    whose noise is at its median. A lag shows early; what lacks at the end would leave nothing to branch.
    """
    steps = np.clip(np.diff(usual), 0.0, PACE)
    steady = np.concatenate([[0.0], np.cumsum(steps)])
    allowed = steady[-1] - LEAST_REWARD

    def score(signals: Any, t: int) -> Any:
        fastest = signals["speed"][:, -5:].max(axis=1) if t >= 34 else np.inf
        late = (steady[t] - signals["reward"][:, -1]) / allowed - 1.0
        found = np.maximum(late, (LEAST_SPEED - fastest) / 4.0)
        return np.where(signals["crashed"][:, -1] > 0.5, 0.0, found)

    return score


def estimate(name: str, parts: int, folder: Path) -> None:
    """Run the missing parts."""
    world.ENGINE = "studies.metadrive_clock"  # before the scenario starts its first process
    os.environ["PYTHONPATH"] = os.pathsep.join([str(Path(__file__).parent), os.environ.get("PYTHONPATH", "")])
    problem = avrare.load(SCENARIO).problem("keeps_up")
    start, _ = world._root_process(_config())

    def clock() -> float:
        return time.process_time() + float(start.call("seconds"))

    if name == "ams":
        problem = problem.rescore(danger(avrare.trace(problem)["reward"]))
    metadrive_parts.run(problem, name, _options()[name], parts, folder, clock)


def cost(steps: int = 150) -> None:
    """CPU time of a step on either side and of a copy, and how much memory that has of its own."""
    import psutil  # comes with MetaDrive

    def used() -> float:
        times = [each.cpu_times() for each in psutil.Process().children(recursive=True)]
        return sum(each.user + each.system for each in times)

    driver = avrare.load(SCENARIO).stack.loop.controller
    one = world.MetaDriveWorld(_config())
    noise = np.random.default_rng(0).standard_normal((steps + 1, one.noise_size))
    one.reset(noise[0])
    here, there = time.process_time(), used()
    for row in noise[1:]:
        action, _ = driver.act(None, one.observation()[None], None)
        one.step(action[0], row)
    here, there = time.process_time() - here, used() - there
    print(f"a step: {1e3 * there / steps:.2f} ms in MetaDrive's process, {1e3 * here / steps:.2f} ms here")
    before = used()
    copies = [one.snapshot() for _ in range(40)]
    print(f"a copy: {1e3 * (used() - before) / len(copies):.1f} ms")
    own = sorted(each.memory_full_info().uss / 2**20 for each in psutil.Process().children(recursive=True))
    print(f"memory of its own: {np.median(own):.1f} MB a copy, {own[-1]:.1f} MB the largest process")


def _options() -> dict[str, dict[str, Any]]:
    """Return the options of a part, and the fingerprint of the scenario that it is of."""
    mark = fingerprint(avrare.load(SCENARIO).definition)
    return {name: chosen | {metadrive_parts.SCENARIO: mark} for name, chosen in OPTIONS.items()}


def _config() -> MetaDriveConfig:
    """Return the options of the scenario's simulator."""
    config: Any = avrare.load(SCENARIO).definition.blocks["simulator"].config
    return config


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("what", choices=["estimate", "cost", "picture", "report"])
    parser.add_argument("name", nargs="?", choices=list(OPTIONS))
    parser.add_argument("--parts", type=int, default=1, help="parts of each estimate that there shall be")
    parser.add_argument("--results", type=Path, default=ROOT / "runs" / "metadrive")
    parser.add_argument("--keep", action="store_true", help=f"write the results into {KEPT.name}")
    given = parser.parse_args()
    kept.unpack(KEPT, given.results)
    match given.what:
        case "estimate":
            for name in [given.name] if given.name else OPTIONS:
                estimate(name, given.parts, given.results)
        case "cost":
            cost()
        case "picture":
            metadrive_picture.draw(SCENARIO, given.results, PICTURES, LEAST_SPEED, LEAST_REWARD)
        case "report":
            print(metadrive_parts.table(given.results, _options()))
    if given.keep:
        kept.pack(KEPT, given.results)


if __name__ == "__main__":
    main()
