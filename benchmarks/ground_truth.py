"""The failure probabilities of a scenario from many Monte Carlo rollouts, to measure estimators against.

    python benchmarks/ground_truth.py [SCENARIO] [--rollouts 100000] [--workers 2] [--set KEY=VALUE]

Runs `avrare run` with a checkpoint, so it may be stopped and started again, and keeps the counts in
docs/ground-truth/SCENARIO-FINGERPRINT.json. The fingerprint is that of the scenario with this many rollouts;
the probabilities hold for any estimator of the same system, which is written down beside them.
"""

from __future__ import annotations

import argparse
import json
import resource
import shlex
import subprocess
import sys
import time
from pathlib import Path

from avrare.scenario.load import load

ROOT = Path(__file__).resolve().parent.parent
KEPT = ("specification", "probability", "interval", "confidence", "rollouts", "failures", "errors", "health")


def main() -> None:
    """Run, keep, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("scenario", nargs="?", default="scenarios/lane_change_published.yaml")
    parser.add_argument("--rollouts", type=int, default=100_000)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE")
    args = parser.parse_args()
    folder = ROOT / "benchmarks" / "results" / f"ground_truth_{Path(args.scenario).stem}"
    settings = [*args.set, f"estimator.rollouts={args.rollouts}"]
    words = ["run", args.scenario, "--estimator", "mc", "--workers", str(args.workers)]
    words += [word for setting in settings for word in ("--set", setting)]
    folder.mkdir(parents=True, exist_ok=True)
    began = time.monotonic()
    call = [sys.executable, "-m", "avrare", *words, "--no-pictures", "--resume", str(folder)]
    subprocess.run(call, cwd=ROOT, check=True)
    seconds = time.monotonic() - began
    result = json.loads((folder / "result.json").read_text(encoding="utf-8"))
    resolved = load(args.scenario, settings).resolved
    kept = {
        "scenario": result["scenario"],
        "system": {name: block for name, block in resolved.items() if name not in ("estimator", "seed")},
        "fingerprint": result["fingerprint"],
        "seed": result["seed"],
        "versions": result["versions"],
        "command": shlex.join(["avrare", *words]),
        "estimates": [{name: entry[name] for name in KEPT} for entry in result["estimates"]],
    }
    file = ROOT / "docs" / "ground-truth" / f"{kept['scenario']}-{kept['fingerprint']}.json"
    file.parent.mkdir(exist_ok=True)
    file.write_text(json.dumps(kept, indent=2) + "\n", encoding="utf-8")
    peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024
    print(f"{file.relative_to(ROOT)} written; {seconds:.0f} s, the largest process had {peak:.0f} MiB")


if __name__ == "__main__":
    main()
