"""Table II of "Adaptive splitting of reusable temporal monitors" again, on our lane change with its truth.

    OMP_NUM_THREADS=1 python benchmarks/table2.py [--workers 2] [--only PATTERN] [--report-only]

For each rule, 20 repetitions of the paper's four methods at its settings (N = 250 rollouts, K = 25 discarded,
10 stages of cross-entropy), and the same with what avrare does better at the cost of its own splitting run.
The truth is 100,000 Monte Carlo rollouts, kept in docs/ground-truth by

    python benchmarks/ground_truth.py scenarios/lane_change_published.yaml --rollouts 100000 \
        --set controller.backend=riccati --set chunk=250

Cells are files in the results folder, named after the
truth's fingerprint; what is there is not run again. Writes docs/table2.md and its pictures from
what there is.
"""

from __future__ import annotations

import argparse
import itertools
import json
import multiprocessing
import re
import time
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from studies import pages, table2_figures, table2_page

import avrare
from avrare.estimation.result.result import Result
from avrare.rollout.loaded_scenario import LoadedScenario
from avrare.scenario.load import load

ROOT = Path(__file__).resolve().parent.parent
SCENARIO = ROOT / "scenarios" / "lane_change_published.yaml"
RESULTS = ROOT / "benchmarks" / "results" / "table2"
SETTINGS = ("controller.backend=riccati", "chunk=250")
"""The compiled controller: casadi takes 25 times as long, and is another system (docs/performance.md)."""
RULES = ("safe_distance", "no_abrupt_braking", "traffic_flow", "left_traffic")
REPEAT = 20
METHODS: dict[str, tuple[str, dict[str, Any]]] = {
    "Raw-MC": ("mc", {"rollouts": 250}),
    "Imp-Naive": ("is", {"rollouts": 250, "defensive": 0.1, "proposal": {"plugin": "naive"}}),
    "Imp-CE": ("ce", {"rollouts": 250, "defensive": 0.1, "stages": 10, "elite": 0.1}),
    "STL-AMS": ("ams", {"particles": 250, "discard": 25, "runs": 1}),
    "MC 900": ("mc", {"rollouts": 900}),
    "AMS 500/50": ("ams", {"particles": 500, "discard": 50, "runs": 1}),
}
"""Name in the paper -> estimator and its options."""
DISCARDS = (2, 25, 125, 225)
"""K of the paper's Figure 4."""


@dataclass(frozen=True)
class Cell:
    """One estimate: a repetition of a method on a rule."""

    digest: str
    rule: str
    method: str
    estimator: str
    options: tuple[tuple[str, Any], ...]
    number: int

    @property
    def file(self) -> str:
        """Path of the outcome."""
        method = self.method.replace(" ", "_").replace("/", ":")
        return f"{self.digest[:8]}-{self.rule}-{method}-{self.number:02d}.json"

    def outcome(self) -> dict[str, Any]:
        """Run it."""
        problem = LoadedScenario(load(SCENARIO, SETTINGS)).problem(self.rule)
        seed = zlib.crc32(f"{self.rule} {self.method} {self.number}".encode())
        began = time.process_time()
        result = avrare.estimate(problem, self.estimator, seed=seed, **dict(self.options))
        return _kept(result) | {"cpu": time.process_time() - began}


def _kept(result: Result) -> dict[str, Any]:
    """Return what the tables and pictures need."""
    whole = result.to_dict()
    names = ("probability", "interval", "rollouts", "simulated_steps", "failures", "errors", "health")
    diagnostics = {name: value for name, value in whole["diagnostics"].items() if np.isscalar(value)}
    return {name: whole[name] for name in names} | {"diagnostics": diagnostics}


def cells(digest: str) -> Iterator[Cell]:
    """Yield all of them: repetitions in turn, so that an interrupted study is fair; then the figures'."""
    for number, rule in itertools.product(range(REPEAT), RULES):
        for method, (name, options) in METHODS.items():
            yield Cell(digest, rule, method, name, tuple(options.items()), number)
    for discard, rule in itertools.product(DISCARDS, RULES):
        options = {"particles": 250, "discard": discard, "runs": 1}
        yield Cell(digest, rule, f"K{discard}", "ams", tuple(options.items()), 0)


def run(task: tuple[Path, Cell, float]) -> str:
    """Run a cell unless the time is over; store its outcome whole or not at all; a line about it."""
    folder, cell, end = task
    if time.monotonic() > end:
        return f"{cell.file}  left for another time"
    outcome = cell.outcome()
    part = folder / f".{cell.file}"
    part.write_text(json.dumps(outcome), encoding="utf-8")
    part.rename(folder / cell.file)
    return f"{cell.file}  {outcome['probability']:.3g}  {outcome['cpu']:.0f} CPU s"


def main() -> None:
    """Run what is missing, then write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--only", default="", metavar="PATTERN", help="cells whose file name matches this")
    parser.add_argument("--results", type=Path, default=RESULTS)
    parser.add_argument("--report-only", action="store_true")
    parser.add_argument("--minutes", type=float, default=1e9, help="begin no cell after so many")
    args = parser.parse_args()
    truth = table2_page.ground_truth(ROOT / "docs" / "ground-truth", load(SCENARIO, SETTINGS))
    args.results.mkdir(parents=True, exist_ok=True)
    todo = [
        cell
        for cell in cells(truth["fingerprint"])
        if re.search(args.only, cell.file) and not (args.results / cell.file).exists()
    ]
    if todo and not args.report_only:
        end = time.monotonic() + 60.0 * args.minutes
        tasks = [(args.results, cell, end) for cell in todo]
        with multiprocessing.get_context("spawn").Pool(args.workers) as pool:
            for done, line in enumerate(pool.imap_unordered(run, tasks), 1):
                print(f"{done}/{len(tasks)}  {line}", flush=True)
    study = table2_page.read(args.results, truth)
    if pages.put(ROOT / "docs" / "table2.md", table2_page.page(study), args.results):
        table2_figures.draw(study, ROOT / "docs" / "table2")


if __name__ == "__main__":
    main()
