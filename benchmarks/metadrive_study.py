"""Case study: the driver that MetaDrive ships behind 240 noisy lidar rays, by Monte Carlo and splitting.

    OMP_NUM_THREADS=1 python benchmarks/metadrive_study.py estimate mc|ams [--workers 2]
    OMP_NUM_THREADS=1 python benchmarks/metadrive_study.py cost
    OMP_NUM_THREADS=1 python benchmarks/metadrive_study.py picture
    python benchmarks/metadrive_study.py report

Runs in the environment of ``docs/metadrive.md``. ``estimate`` keeps its result and the failing tapes in the
results folder; interrupted, it goes on from there. ``picture`` draws from them (it needs matplotlib),
``report`` prints the table. All estimates take about 5 CPU minutes.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

import numpy as np
from studies import case_table, metadrive_picture

import avrare

ROOT = Path(__file__).parents[1]
SCENARIO = ROOT / "scenarios" / "merge_metadrive.yaml"
OPTIONS: dict[str, dict[str, Any]] = {
    "mc": {"seed": 1, "rollouts": 200},
    "ams": {"seed": 5, "particles": 60, "discard": 12, "runs": 3},
}


def danger(signals: Any, t: int) -> Any:
    """Score that splitting orders by, in m/s: how slow the last five samples, or how near the others.

    Centimetres are weighed so that who passes at 1.85 m (the least without a collision) is as near to failing
    as who falls to 5.6 m/s; what has not failed stays below 0.
    """
    slow = 5.0 - signals["speed"][:, -5:].max(axis=1) if t >= 34 else -5.0
    near = 4.0 * (1.7 - signals["nearest"][:, -1])
    return np.where(signals["crashed"][:, -1] > 0.5, 1.0, np.maximum(slow, near))


def estimate(name: str, workers: int, folder: Path) -> None:
    """One estimate, unless it has been made already."""
    if (folder / f"{name}.json").exists():
        return
    problem = avrare.load(SCENARIO).problem("keeps_up")
    problem = problem.rescored(danger) if name == "ams" else problem
    folder.mkdir(parents=True, exist_ok=True)
    result = avrare.estimate(
        problem, name, workers=workers, checkpoint=folder / f"{name}-chunks", **OPTIONS[name]
    )
    np.savez(folder / f"{name}.npz", noise=result.failures.noise)
    (folder / f"{name}.json").write_text(json.dumps(json.loads(result.to_json()), indent=1))
    print(name, result.probability, result.interval, result.rollouts, result.simulated_steps, result.health)


def cost(steps: int = 150) -> None:
    """CPU time of a step on either side and of a copy, and how much memory that has of its own."""
    import psutil  # comes with MetaDrive

    def used() -> float:
        times = [one.cpu_times() for one in psutil.Process().children(recursive=True)]
        return sum(one.user + one.system for one in times)

    simulator, driver = _parts()
    world = simulator.settings[0]()
    noise = np.random.default_rng(0).standard_normal((steps + 1, world.noise_size))
    world.reset(noise[0])
    here, there = time.process_time(), used()
    for row in noise[1:]:
        action, _ = driver.act(None, world.observation()[None], None)
        world.step(action[0], row)
    here, there = time.process_time() - here, used() - there
    print(f"a step: {1e3 * there / steps:.2f} ms in MetaDrive's process, {1e3 * here / steps:.2f} ms here")
    before = used()
    copies = [world.snapshot() for _ in range(40)]
    print(f"a copy: {1e3 * (used() - before) / len(copies):.1f} ms")
    own = sorted(one.memory_full_info().uss / 2**20 for one in psutil.Process().children(recursive=True))
    print(f"memory of its own: {np.median(own):.1f} MB a copy, {own[-1]:.1f} MB the largest process")


def _parts() -> tuple[Any, Any]:
    """Simulator and driver of the scenario."""
    loop = avrare.load(SCENARIO).stack.loop
    return loop.simulator, loop.controller


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("what", choices=["estimate", "cost", "picture", "report"])
    parser.add_argument("name", nargs="?", choices=list(OPTIONS))
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--results", type=Path, default=ROOT / "runs" / "metadrive")
    given = parser.parse_args()
    match given.what:
        case "estimate":
            for name in [given.name] if given.name else OPTIONS:
                estimate(name, given.workers, given.results)
        case "cost":
            cost()
        case "picture":
            tapes = np.load(given.results / "mc.npz", allow_pickle=False)["noise"]
            metadrive_picture.draw(*_parts(), tapes, ROOT / "docs" / "metadrive")
        case "report":
            case_table.show(given.results, OPTIONS)


if __name__ == "__main__":
    main()
