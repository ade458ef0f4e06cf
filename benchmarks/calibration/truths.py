"""Brute force for the problems without a formula: python -m benchmarks.calibration.truths [--rollouts 2e7].

Adds rollouts to ``problems/truths.json`` until each problem has so many; a chunk that was counted is not
counted again, so it may be stopped.
"""

from __future__ import annotations

import argparse
import json
import zlib

import numpy as np

from benchmarks.calibration.problems.driving import TRUTHS, systems
from benchmarks.calibration.problems.problem import rolled

CHUNK, SEED = 100_000, 2026


def main() -> None:
    """Count the failures that are missing."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--rollouts", type=float, default=2e7, help="of each problem")
    parser.add_argument("--only", default="", help="problems whose name holds this")
    args = parser.parse_args()
    kept = json.loads(TRUTHS.read_text(encoding="utf-8")) if TRUTHS.exists() else {}
    for name, (_, system) in systems().items():
        found = kept.setdefault(name, {"failures": 0, "rollouts": 0})
        while args.only in name and found["rollouts"] < args.rollouts:
            # Each chunk has a seed of its own, by its number.
            generator = np.random.Generator(
                np.random.SFC64(
                    np.random.SeedSequence([SEED, zlib.crc32(name.encode()), found["rollouts"] // CHUNK])
                )
            )
            tapes = generator.standard_normal((CHUNK, system.steps * system.noise_size))
            found["failures"] += int((rolled(system, tapes) <= 0.0).sum())
            found["rollouts"] += CHUNK
            TRUTHS.write_text(json.dumps(kept, indent=1) + "\n", encoding="utf-8")
        print(name, found, f"{found['failures'] / max(found['rollouts'], 1):.3g}", flush=True)


if __name__ == "__main__":
    main()
