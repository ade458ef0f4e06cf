"""Elliptical slice sampling on problems with exact answers: bias, cost, validity of its kernels, coverage.

    OMP_NUM_THREADS=1 python benchmarks/ess.py [--workers 2] [--only PATTERN] [--results DIR] [--report-only]

Cells are cut into blocks, each a file in the results folder: what is there is not run again, so the study may
be stopped and resumed. Writes the tables of docs/slice-sampling/*.csv from what there is. About one CPU hour.

- bias: mean over truth of independent runs, with the second pass at fixed levels and without it; relative
  mean squared error times evaluations (those of the pilot included);
- stationary: 60,000 exact starts, ten steps of a kernel: do mean and variance of the score stay?
- coverage: 200 intervals of ten runs.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import sys
import tempfile
import time
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from studies import pages
from studies.run_intervals import interval_of_runs

import avrare
from avrare.testing.problems import conjunction, four_branch, linear, reference_problem
from avrare.testing.reference_problem import ReferenceProblem

TABLES = Path(__file__).parent.parent / "docs" / "slice-sampling"
PROBLEMS = (
    "a_beta_-2", "a_beta_-2.5", "a_beta_-3", "b_linear_d100_p1e-4", "b_linear_d100_p1e-6",
    "b_linear_d100_p1e-9", "c_fourbranch_k6", "c_fourbranch_k7", "i_exp_sum_d10_c30.0",
    "i_exp_sum_d10_c40.0", "i_lognormal_prod_d1", "i_lognormal_prod_d5",
)  # fmt: skip
BEYOND = replace(linear(7.0), id="b_linear_d100_b7")
"""Rarer than any reference problem, for exact slices: 1.3e-12 in 100 dimensions."""
COVERED = ("a_beta_-2", "b_linear_d100_p1e-4", "c_fourbranch_k7", "d_rw_L3.8", "i_lognormal_prod_d1")
REGIONS = {"a": (conjunction(-1.2),), "b": (linear(1.5, 20),), "c": (four_branch(4.0),)}
"""Sets whose law the kernels are to leave as it is: where these problems fail."""
STARTS, STEPS = 60_000, 10
SLOW = {"bayesian": 6_000}
"""Starts of a kernel that takes its time."""
BLOCK = 50
"""Runs of a block."""


@dataclass(frozen=True)
class Setting:
    """A kernel with its options, and how many runs of it are made."""

    name: str
    runs: int
    options: dict[str, Any]
    only: str = ""
    estimator: str = "ess"

    def suits(self, problem: str) -> bool:
        """Tell whether the kernel fits: a bound on the slope must exist, or predicates must be affine."""
        exact = self.estimator == "ess_linear"
        return (not self.only or problem[0] in self.only) and (exact or problem != BEYOND.id)


_FULL = {"chains": 200, "pilot": 0.1}
SETTINGS = (
    Setting("pcn", 200, {"kernel": "pcn", **_FULL}),
    Setting("pcn-single", 200, {"kernel": "pcn", "chains": 200, "second_pass": False}),
    Setting("shrink", 200, {"kernel": "shrink", **_FULL}),
    Setting("shrink-single", 200, {"kernel": "shrink", "chains": 200, "second_pass": False}),
    Setting("shrink-3", 200, {"kernel": {"name": "shrink", "bracket": 3.0}, **_FULL}, "abc"),
    Setting("exact", 200, {"chains": 50}, "ab", "ess_linear"),
    Setting("lipschitz", 200, {"kernel": {"name": "lipschitz", "bound": 1.0}, "chains": 50}, "ab"),
    Setting("surrogate", 200, {"kernel": "surrogate", "chains": 100}, "aci"),
    Setting("surrogate-b", 200, {"kernel": "surrogate", "chains": 100}, "b"),
    Setting("growing", 100, {"kernel": {"name": "lipschitz_growing", "guess": 0.3}, "chains": 50}),
    Setting("bayesian", 50, {"kernel": "bayesian", "chains": 50}),
)


def _reference(name: str) -> ReferenceProblem:
    return BEYOND if name == BEYOND.id else reference_problem(name)


@dataclass(frozen=True)
class RunBlock:
    """Independent runs of one setting on one problem."""

    study: str
    setting: Setting
    problem: str
    number: int
    runs: int

    @property
    def cell(self) -> str:
        """Its cell's name."""
        return f"{self.study}-{self.setting.name}-{self.problem}"

    @property
    def file(self) -> str:
        """Path of the outcome."""
        return f"{self.cell}-{self.number:03d}.npz"

    def outcome(self) -> dict[str, Any]:
        """Run it."""
        seed = 1000 * zlib.crc32(self.cell.encode()) + self.number
        problem, setting = _reference(self.problem).problem(chunk=10_000), self.setting
        result = avrare.estimate(problem, setting.estimator, runs=self.runs, seed=seed, **setting.options)
        return {"values": result.run_probabilities, "rollouts": result.rollouts}


@dataclass(frozen=True)
class DriftBlock:
    """A kernel on exact starts of one region."""

    kernel: str
    region: str

    @property
    def cell(self) -> str:
        """Its cell's name."""
        return f"stationary-{self.kernel}-{self.region}"

    @property
    def file(self) -> str:
        """Path of the outcome."""
        return f"{self.cell}-000.npz"

    def outcome(self) -> dict[str, Any]:
        """Move the chains."""
        from studies.stationarity import drift, exact_starts

        reference: ReferenceProblem = REGIONS[self.region][0]
        problem, many = reference.problem(chunk=STARTS), SLOW.get(self.kernel, STARTS)
        starts = exact_starts(problem, 0.0, many, seed=zlib.crc32(self.region.encode()))
        kernel, tuning = _drifting(self.kernel, problem.noise_size)
        seed = zlib.crc32(self.cell.encode())
        return vars(drift(problem, kernel, tuning, starts, 0.0, STEPS, seed))


def _drifting(name: str, size: int) -> tuple[Any, Any]:
    """Return a kernel and what it knows: for the surrogate something deliberately wrong."""
    from avrare_estimators.common.chains.pcn import PcnKernel
    from avrare_estimators.ess.kernels import lipschitz, shrink, stl_ess, surrogate

    rng = np.random.default_rng(0)
    wrong = surrogate.Surface(
        np.array([0.3]), 0.5 + 0.3 * rng.normal(size=(1, size)), 0.2 * rng.normal(size=(1, size)),
        np.array([size / 4]), np.array([1.0]),
    )  # fmt: skip
    if name.startswith("growing"):
        guess = float(name.removeprefix("growing"))
        return stl_ess.GrowingLipschitzKernel(guess), np.array([guess])
    kernels: dict[str, tuple[Any, Any]] = {
        "shrink": (shrink.ShrinkKernel(), ()),
        "shrink-3": (shrink.ShrinkKernel(3.0), ()),
        "pcn": (PcnKernel(), np.array([0.7])),
        "surrogate": (surrogate.SurrogateKernel(), wrong),
        "lipschitz": (lipschitz.LipschitzKernel(1.0), ()),
        "bayesian": (stl_ess.BayesianKernel(), ()),
    }
    return kernels[name]


DRIFTING = (
    "shrink", "shrink-3", "pcn", "surrogate", "lipschitz", "growing3", "growing1", "growing0.3", "bayesian",
)  # fmt: skip


def blocks() -> Iterator[RunBlock | DriftBlock]:
    """Return all blocks, the cheap studies first."""
    for kernel in DRIFTING:
        for region in REGIONS:
            if not (kernel == "lipschitz" and region == "c"):  # its slope has no bound
                yield DriftBlock(kernel, region)
    for problem in COVERED:
        setting = Setting("default", 2000, {})
        yield from _cut("coverage", setting, problem, 200)
    for setting in SETTINGS:
        for problem in (*PROBLEMS, BEYOND.id):
            if setting.suits(problem):
                yield from _cut("bias", setting, problem, BLOCK)


def _cut(study: str, setting: Setting, problem: str, size: int) -> Iterator[RunBlock]:
    for number, first in enumerate(range(0, setting.runs, size)):
        yield RunBlock(study, setting, problem, number, min(size, setting.runs - first))


def main(argv: list[str]) -> None:
    """Run what is missing, then write the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--only", default="", help="cells whose name holds this")
    parser.add_argument("--results", type=Path, default=Path(__file__).parent / "results" / "ess")
    parser.add_argument("--report-only", action="store_true")
    args = parser.parse_args(argv)
    args.results.mkdir(parents=True, exist_ok=True)
    if not args.report_only:
        run_missing(args.results, args.only, args.workers)
    write(args.results)


def run_missing(results: Path, only: str, workers: int) -> None:
    """Run every block that has no file yet."""
    chosen = [block for block in blocks() if only in block.cell]
    missing = [(results, block) for block in chosen if not (results / block.file).exists()]
    print(f"{len(chosen) - len(missing)} of {len(chosen)} blocks are there", flush=True)
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    with multiprocessing.get_context("spawn").Pool(workers, maxtasksperchild=20) as pool:
        for done, line in enumerate(pool.imap_unordered(run, missing), start=1):
            print(f"{done}/{len(missing)}  {line}", flush=True)


def run(task: tuple[Path, RunBlock | DriftBlock]) -> str:
    """Run a block and store its outcome, whole or not at all; return a line about it."""
    folder, block = task
    began = time.process_time()
    outcome = block.outcome()
    handle, temporary = tempfile.mkstemp(dir=folder, prefix=".", suffix=".npz")
    os.close(handle)
    np.savez_compressed(temporary, **outcome)
    os.replace(temporary, folder / block.file)
    return f"{block.file}  {time.process_time() - began:.0f} CPU s"


def write(results: Path) -> None:
    """Write the tables of the page."""
    tables = {"bias": _bias(results), "stationary": _stationary(results), "coverage": _coverage(results)}
    for name, lines in tables.items():
        pages.put(TABLES / f"{name}.csv", "".join(f"{line}\n" for line in lines), results)


def _load(results: Path, cell: str) -> dict[str, np.ndarray] | None:
    loaded = [dict(np.load(file)) for file in sorted(results.glob(f"{cell}-[0-9][0-9][0-9].npz"))]
    if not loaded:
        return None
    return {name: np.concatenate([np.atleast_1d(block[name]) for block in loaded]) for name in loaded[0]}


def _bias(results: Path) -> Iterator[str]:
    yield "kernel,problem,runs,mean / p,standard error,z,extinct,evaluations,MSE x evaluations"
    for setting in SETTINGS:
        for problem in (*PROBLEMS, BEYOND.id):
            data = _load(results, f"bias-{setting.name}-{problem}")
            if data is not None:
                yield _bias_row(setting, problem, data)


def _bias_row(setting: Setting, problem: str, data: dict[str, np.ndarray]) -> str:
    ratio = data["values"] / _reference(problem).probability
    error, cost = ratio.std(ddof=1) / np.sqrt(len(ratio)), data["rollouts"].sum() / len(ratio)
    product = ((ratio - 1.0) ** 2).mean() * cost
    return (
        f"{setting.name},{problem},{len(ratio)},{ratio.mean():.3f},{error:.3f},"
        f"{(ratio.mean() - 1.0) / error:.1f},{(ratio == 0.0).mean():.2f},{cost:.0f},{product:.0f}"
    )


def _stationary(results: Path) -> Iterator[str]:
    yield "kernel,region,z of the mean,z of the mean square,outside,rollouts a step,accepted"
    for kernel in DRIFTING:
        for region in REGIONS:
            data = _load(results, f"stationary-{kernel}-{region}")
            if data is not None:
                row = {name: float(values[0]) for name, values in data.items()}
                yield (
                    f"{kernel},{region},{row['mean']:.1f},{row['square']:.1f},"
                    f"{row['outside']:.3f},{row['rollouts']:.2f},{row['accepted']:.2f}"
                )


def _coverage(results: Path) -> Iterator[str]:
    yield "problem,p,intervals,cover,below the truth,above it,median upper end / p"
    for problem in COVERED:
        data = _load(results, f"coverage-default-{problem}")
        if data is None:
            continue
        truth = reference_problem(problem).probability
        groups = data["values"].reshape(-1, 10)
        bounds = np.array([interval_of_runs(group, 500)(0.95) for group in groups])
        below, above = (bounds[:, 1] < truth).mean(), (bounds[:, 0] > truth).mean()
        yield (
            f"{problem},{truth:.3g},{len(groups)},{1 - below - above:.3f},{below:.3f},"
            f"{above:.3f},{np.median(bounds[:, 1]) / truth:.2f}"
        )


if __name__ == "__main__":
    main(sys.argv[1:])
