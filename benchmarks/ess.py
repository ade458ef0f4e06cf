"""Validity of the kernels of elliptical slice sampling: do they leave the law of a level's set as it is?

    OMP_NUM_THREADS=1 python benchmarks/ess.py [--only PATTERN] [--results FILE]

From 60,000 exact starts, ten steps of a kernel: do mean and variance of the score stay? Each cell is a line
of the results: what is there is not run again. Writes docs/slice-sampling/stationary.csv.
"""

from __future__ import annotations

import argparse
import json
import sys
import zlib
from collections.abc import Callable, Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from studies import kept, pages
from studies.stationarity import drift, exact_starts

from avrare.testing.problems import conjunction, four_branch, linear
from avrare_estimators.common.chains.pcn import PcnKernel
from avrare_estimators.ess.kernels import lipschitz, shrink, stl_ess

TABLE = Path(__file__).parent.parent / "docs" / "slice-sampling" / "stationary.csv"
RESULTS = Path(__file__).parent / "results" / "ess.jsonl"
REGIONS = {"a": conjunction(-1.2), "b": linear(1.5, 20), "c": four_branch(4.0)}
"""Sets whose law the kernels are to leave as it is: where these problems fail."""
STARTS, STEPS = 60_000, 10
SLOW = {"bayesian": 6_000}
"""Starts of a kernel that takes its time."""


def _growing(guess: float) -> tuple[Any, Any]:
    return stl_ess.GrowingLipschitzKernel(guess), np.array([guess])


KERNELS: dict[str, Callable[[int], tuple[Any, Any]]] = {
    "shrink": lambda size: (shrink.ShrinkKernel(), ()),
    "shrink-3": lambda size: (shrink.ShrinkKernel(3.0), ()),
    "pcn": lambda size: (PcnKernel(), np.array([0.7])),
    "lipschitz": lambda size: (lipschitz.LipschitzKernel(1.0), ()),
    "growing3": lambda size: _growing(3.0),
    "growing1": lambda size: _growing(1.0),
    "growing0.3": lambda size: _growing(0.3),
    "bayesian": lambda size: (stl_ess.BayesianKernel(), ()),
}
"""Kernels by name, with what they know of the set."""


def main(argv: list[str]) -> None:
    """Run what is missing, then write the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--only", default="", help="cells whose name holds this, as pcn-a")
    parser.add_argument("--results", type=Path, default=RESULTS, help="file")
    given = parser.parse_args(argv)
    given.results.parent.mkdir(parents=True, exist_ok=True)
    results = {line["cell"]: line for line in kept.lines(given.results)}
    for kernel, region in cells():
        cell = f"{kernel}-{region}"
        if cell not in results and given.only in cell:
            results[cell] = {"cell": cell, **measure(kernel, region)}
            with given.results.open("a") as file:
                print(json.dumps(results[cell]), file=file)
            print(cell, flush=True)
    pages.put(TABLE, "".join(f"{line}\n" for line in list_lines(results)), given.results.parent)


def cells() -> Iterator[tuple[str, str]]:
    """Yield kernels with their regions."""
    for kernel in KERNELS:
        for region in REGIONS:
            if not (kernel == "lipschitz" and region == "c"):  # its slope has no bound
                yield kernel, region


def measure(name: str, region: str) -> dict[str, float]:
    """Move the chains, and return how far their scores drift."""
    problem, chains = REGIONS[region].problem(chunk=STARTS), SLOW.get(name, STARTS)
    starts = exact_starts(problem, 0.0, chains, seed=zlib.crc32(region.encode()))
    kernel, tuning = KERNELS[name](problem.noise_size)
    seed = zlib.crc32(f"stationary-{name}-{region}".encode())
    return asdict(drift(problem, kernel, tuning, starts, 0.0, STEPS, seed))


def list_lines(results: dict[str, dict[str, Any]]) -> Iterator[str]:
    """Yield the lines of the table."""
    yield "kernel,region,z of the mean,z of the mean square,outside,rollouts a step,accepted"
    for kernel, region in cells():
        if line := results.get(f"{kernel}-{region}"):
            yield (
                f"{kernel},{region},{line['mean']:.1f},{line['square']:.1f},"
                f"{line['outside']:.3f},{line['rollouts']:.2f},{line['accepted']:.2f}"
            )


if __name__ == "__main__":
    main(sys.argv[1:])
