"""Give each ground truth the fingerprint of today's system, once its rollouts give the same robustness.

    python benchmarks/rekey_truths.py [--rows 200]

A fingerprint changes with the spelling of an option or a new option's default. For each file of
docs/ground-truth, up to `--rows` rollouts of every tail are driven again by their addresses. Where the
robustness of each is the same within `TOLERANCE`, the truth moves to the present fingerprint; else it stays,
its first difference is printed, and the exit code is 1. A truth without tails cannot be driven, and stays.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

import numpy as np
from ground_truth import TRUTHS, describe_system
from studies import truth

from avrare.rollout.loaded_scenario import LoadedScenario
from avrare.rollout.noise import NoiseSource
from avrare.rollout.request import Request
from avrare.scenario.fingerprint import fingerprint
from avrare.scenario.load import load

ROOT = Path(__file__).resolve().parent.parent
TOLERANCE = 1e-6
"""Largest difference of a robustness: processors, and chunks of other sizes, round matrix products apart."""


def main() -> int:
    """Replay and re-key every truth, and return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--rows", type=int, default=200, help="rollouts of each tail to drive again")
    parser.add_argument("--truths", type=Path, default=TRUTHS)
    args = parser.parse_args()
    verdicts = [rekey(file, args.rows) for file in sorted(args.truths.glob("*.json"))]
    print("\n".join(text for _, text in verdicts))
    return 0 if all(same for same, _ in verdicts) else 1


def rekey(file: Path, rows: int) -> tuple[bool, str]:
    """Replay the tails of a truth and move it to the present fingerprint; return (same bits, a line)."""
    stored = json.loads(file.read_text(encoding="utf-8"))
    tails = truth.read_tails(file)
    if not tails:
        return True, f"{file.name}: no tails, stays"
    rollouts = stored["estimates"][0]["rollouts"]
    settings = ["estimator={plugin: mc}", f"estimator.rollouts={rollouts}"]
    scenario = LoadedScenario(load(ROOT / "scenarios" / f"{stored['scenario']}.yaml", settings))
    replayed, largest = 0, 0.0
    for name, tail in tails.items():
        count = min(rows, len(tail.particle))
        robustness = drive_again(scenario, stored["seed"], name, tail.particle[:count])
        difference = np.abs(robustness - tail.robustness[:count])
        if differs := np.flatnonzero(~(difference <= TOLERANCE)).tolist():
            first = differs[0]
            return False, (
                f"{file.name}: {name}: {len(differs)} of {count} rollouts differ, first that of particle "
                f"{tail.particle[first]}: {tail.robustness[first]!r} became {robustness[first]!r}"
            )
        replayed, largest = replayed + count, max(largest, float(difference.max()))
    digest = fingerprint(scenario.definition)
    text = f"{file.name}: {replayed} rollouts differ by at most {largest:.1g}"
    if digest == stored["fingerprint"]:
        return True, text
    stored |= {"fingerprint": digest, **describe_system(scenario.definition)}
    target = file.with_name(f"{stored['scenario']}-{digest}.json")
    file.with_suffix(".npz").rename(target.with_suffix(".npz"))
    file.rename(target).write_text(json.dumps(stored, indent=2) + "\n", encoding="utf-8")
    return True, f"{text}, now {target.name}"


def drive_again(scenario: LoadedScenario, seed: int, name: str, particles: truth.Integers) -> truth.Floats:
    """Return the robustness (n,) of a specification in the rollouts of particles (n,) of run 0, stage 0."""
    problem = scenario.problem(name)
    request = Request.from_start(np.zeros_like(particles), particles)
    return problem.simulate(NoiseSource(seed, problem.noise_size), request).robustness[:, 0]


if __name__ == "__main__":
    sys.exit(main())
