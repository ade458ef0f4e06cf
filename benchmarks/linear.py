"""The double integrator between two boxes: exact slices against large Monte Carlo.

    OMP_NUM_THREADS=1 nice python benchmarks/linear.py gaussian OUT.jsonl [CHUNKS] [SHARD/SHARDS]
    OMP_NUM_THREADS=1 nice python benchmarks/linear.py loop OUT.jsonl [CHUNKS] [SHARD/SHARDS]
    OMP_NUM_THREADS=1 nice python benchmarks/linear.py simulator OUT.jsonl [CHUNKS] [SHARD/SHARDS]
    OMP_NUM_THREADS=1 nice python benchmarks/linear.py exact OUT.jsonl [SEEDS] [SHARD/SHARDS]
    OMP_NUM_THREADS=1 python benchmarks/linear.py report OUT.jsonl

``gaussian`` draws trajectories from their exact law, 100,000 a chunk; ``loop`` steps the closed loop, plant,
observer and feedback, on tapes that NumPy draws, 100,000 a chunk; ``simulator`` does so as the estimator
``mc``, with the library's own noise, 20,000 a chunk; ``exact`` is one estimate a seed. Each chunk is a line
of the file and is never done twice, so that a run may be interrupted and go on, and shards may write files
of their own (``cat`` joins them).
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import avrare
from avrare.estimation.intervals import clopper_pearson
from avrare_linear.gaussian import TrajectoryGaussian

SCENARIO = Path(__file__).parents[1] / "scenarios" / "double_integrator.yaml"
DEFAULTS = {"gaussian": 100, "loop": 100, "simulator": 10, "exact": 10}


def from_gaussian() -> Callable[[int], dict[str, Any]]:
    problem = avrare.load(SCENARIO).problem("clear")
    formula = problem.monitors[0].formula  # type: ignore[attr-defined]
    law = TrajectoryGaussian.of(problem.system, problem.steps, formula.signals)
    root = np.linalg.cholesky(law.covariance.reshape(law.mean.size, -1))

    def chunk(index: int) -> dict[str, Any]:
        normal = np.random.default_rng([1, index]).standard_normal((100_000, law.mean.size))
        values = law.mean + (normal @ root.T).reshape(-1, *law.mean.shape)
        held = formula.satisfied({name: values[:, :, i] for i, name in enumerate(law.names)})[:, 0]
        return {"rollouts": len(held), "failures": int((~held).sum())}

    return chunk


def from_loop() -> Callable[[int], dict[str, Any]]:
    problem = avrare.load(SCENARIO, ["chunk=20000"]).problem("clear")

    def chunk(index: int) -> dict[str, Any]:
        source, failures = np.random.default_rng([2, index]), 0
        for _ in range(5):
            tapes = source.standard_normal((20_000, problem.steps + 1, problem.noise_size))
            failures += int((problem.robustness(tapes) < 0.0).sum())
        return {"rollouts": 100_000, "failures": failures}

    return chunk


def from_simulator() -> Callable[[int], dict[str, Any]]:
    problem = avrare.load(SCENARIO, ["chunk=4000"]).problem("clear")

    def chunk(index: int) -> dict[str, Any]:
        result = avrare.estimate(problem, "mc", seed=1000 + index, rollouts=20_000)
        return {"rollouts": result.rollouts, "failures": round(result.probability * result.rollouts)}

    return chunk


def exactly() -> Callable[[int], dict[str, Any]]:
    problem = avrare.load(SCENARIO).problem("clear")

    def chunk(index: int) -> dict[str, Any]:
        result = avrare.estimate(problem, "ess_linear", seed=index, chains=100)
        found = {"probability": result.probability, "interval": result.interval, "rollouts": result.rollouts}
        return {**found, "health": list(result.health)}

    return chunk


def work(kind: str, path: Path, count: int, shard: str) -> None:
    """Do the chunks of a shard that the file has not yet."""
    lines = [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []
    done = {line["chunk"] for line in lines if line["kind"] == kind}
    first, shards = map(int, shard.split("/"))
    chunk = {
        "gaussian": from_gaussian, "loop": from_loop, "simulator": from_simulator, "exact": exactly,
    }[kind]()  # fmt: skip
    for index in range(first, count, shards):
        if index not in done:
            began = time.process_time()
            found = {"kind": kind, "chunk": index, **chunk(index), "seconds": time.process_time() - began}
            with path.open("a") as file:
                print(json.dumps(found), file=file)
    report(path)


def report(path: Path) -> None:
    lines = [json.loads(line) for line in path.read_text().splitlines()]
    for kind in DEFAULTS:
        some = [line for line in lines if line["kind"] == kind]
        if not some:
            continue
        rollouts, seconds = sum(line["rollouts"] for line in some), sum(line["seconds"] for line in some)
        if kind == "exact":
            values = np.array([line["probability"] for line in some])
            error = values.std(ddof=1) / np.sqrt(len(values)) if len(values) > 1 else np.nan
            print(f"exact      {len(values)} estimates  mean {values.mean():.4g} +- {error:.2g}", end="")
            print(f"  relative RMSE of one {values.std() / values.mean():.3f}", end="")
        else:
            failures = sum(line["failures"] for line in some)
            low, high = clopper_pearson(failures, rollouts, 0.95)
            print(
                f"{kind:10s} {failures} failures  {failures / rollouts:.4g}  [{low:.4g}, {high:.4g}]", end=""
            )
        print(f"  {rollouts:,} rollouts  {seconds:.0f} s of CPU", flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("kind", choices=(*DEFAULTS, "report"))
    parser.add_argument("path", type=Path, metavar="OUT.jsonl")
    parser.add_argument("count", type=int, nargs="?", help="chunks, or seeds")
    parser.add_argument("shard", nargs="?", default="0/1", metavar="SHARD/SHARDS")
    args = parser.parse_args()
    if args.kind == "report":
        report(args.path)
    else:
        work(args.kind, args.path, args.count or DEFAULTS[args.kind], args.shard)
