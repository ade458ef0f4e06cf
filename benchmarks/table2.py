"""Table II of "Adaptive splitting of reusable temporal monitors" again, on our lane change with its truth.

    OMP_NUM_THREADS=1 python benchmarks/table2.py [SCENARIO] [--workers 2] [--only PATTERN] [--report-only]

For each rule, 20 repetitions of the paper's four methods at its settings (N = 250 rollouts, K = 25 discarded,
10 stages of cross-entropy), and the same with what avrare does better at the cost of its own splitting run.
The truth is 100,000 Monte Carlo rollouts, kept in docs/ground-truth by

    python benchmarks/ground_truth.py SCENARIO --rollouts 100000 SETTINGS

with the settings printed by --truth-command. Cells are files in the results folder, named after the
truth's fingerprint; what is there is not run again. Writes docs/table2.md and its pictures from
what there is.

With another scene, `scenarios/lane_change.yaml` say, the methods are those of SCENE_METHODS, the rules those
of its truth that are not rarer than table2_page.LEAST_TRUTH, and the page is docs/table2-NAME.md. A cell is
then a call of five runs, which share batches. `--keep` packs the cells beside the page; a results folder that
is not there begins with them.
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
from studies import kept, pages, table2_figures, table2_page

import avrare
from avrare.estimation.result.result import Result
from avrare.rollout.loaded_scenario import LoadedScenario
from avrare.scenario.load import load

ROOT = Path(__file__).resolve().parent.parent
RESULTS = ROOT / "benchmarks" / "results" / "table2"
SETTINGS = ("controller.backend=riccati", "chunk=250")
"""The compiled controller: casadi takes 25 times as long, and is another system (docs/performance.md)."""
RULES = ("safe_distance", "no_abrupt_braking", "traffic_flow", "left_traffic")
REPEAT = 20
METHODS: dict[str, tuple[str, dict[str, Any]]] = {
    "Raw-MC": ("mc", {"rollouts": 250}),
    "Imp-Naive": ("is", {"rollouts": 250, "defensive": 0.1, "proposal": {"plugin": "naive"}}),
    "Imp-CE": ("ce", {"rollouts": 250, "defensive": 0.1, "stages": 10, "elite": 0.1, "family": "network"}),
    "STL-AMS": ("ams", {"particles": 250, "discard": 25, "runs": 1}),
    "MC 900": ("mc", {"rollouts": 900}),
    "AMS 500/50": ("ams", {"particles": 500, "discard": 50, "runs": 1}),
}
"""Name in the paper -> estimator and its options."""
SCENE_METHODS: dict[str, tuple[str, dict[str, Any]]] = {
    **{name: METHODS[name] for name in ("Raw-MC", "STL-AMS", "MC 900")},
    "CE gaussian": ("ce", {"rollouts": 250, "stages": 10, "elite": 0.1}),
    "ESS": ("ess", {"chains": 50, "runs": 1}),
    "IS learned": ("is", {"rollouts": 9000, "proposal": "learned"}),
}
"""Methods for scenes whose errors last: there the densities of observations are not known."""
SCENE_RUNS = 5
"""Runs of a cell of such a scene: the 25 rows of one run's level leave the compiled controller idle."""
COSTLY = ("IS learned",)
"""Methods that come when all cells of the others are there."""
PUBLISHED = "lane_change_published"
DISCARDS = (2, 25, 125, 225)
"""K of the paper's Figure 4."""


@dataclass(frozen=True)
class Cell:
    """One estimate: a method on a rule, one repetition of it or, on another scene, SCENE_RUNS of them."""

    scenario: str
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
        problem = LoadedScenario(load(self.scenario, settings_of(self.scenario))).problem(self.rule)
        seed = zlib.crc32(f"{self.rule} {self.method} {self.number}".encode())
        began = time.process_time()
        result = avrare.estimate(problem, self.estimator, seed=seed, **dict(self.options))
        return _kept(result) | {"cpu": time.process_time() - began}


def _kept(result: Result) -> dict[str, Any]:
    """Return what the tables and pictures need."""
    whole = result.to_dict()
    names = ("probability", "interval", "rollouts", "simulated_steps", "failures", "errors", "health")
    diagnostics = {name: value for name, value in whole["diagnostics"].items() if np.isscalar(value)}
    runs = [float(p) for p in result.run_probabilities]
    return {name: whole[name] for name in names} | {"diagnostics": diagnostics, "run_probabilities": runs}


def settings_of(scenario: str) -> tuple[str, ...]:
    """Return the overrides of a scenario file."""
    return SETTINGS if Path(scenario).stem == PUBLISHED else ()


def cells(scenario: str, truth: dict[str, Any]) -> Iterator[Cell]:
    """Yield all of them: repetitions in turn, so that an interrupted study is fair; then the figures'."""
    digest, published = truth["fingerprint"], truth["scenario"] == PUBLISHED
    rules = RULES if published else table2_page.rules_of(truth["estimates"])
    methods, runs = (METHODS, {}) if published else (SCENE_METHODS, {"runs": SCENE_RUNS})
    numbers = range(REPEAT if published else REPEAT // SCENE_RUNS)
    for costly, number, rule in itertools.product((False, True), numbers, rules):
        for method, (name, options) in methods.items():
            if (method in COSTLY) == costly:
                yield Cell(scenario, digest, rule, method, name, tuple((options | runs).items()), number)
    if not published:
        return
    for discard in DISCARDS:
        for rule in RULES:
            options = {"particles": 250, "discard": discard, "runs": 1}
            yield Cell(scenario, digest, rule, f"K{discard}", "ams", tuple(options.items()), 0)


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
    parser.add_argument("scenario", nargs="?", default="scenarios/lane_change_published.yaml")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--only", default="", metavar="PATTERN", help="cells whose file name matches this")
    parser.add_argument("--results", type=Path, default=RESULTS)
    parser.add_argument("--report-only", action="store_true")
    parser.add_argument("--minutes", type=float, default=1e9, help="begin no cell after so many")
    parser.add_argument("--keep", action="store_true", help="pack the scene's cells beside its page")
    parser.add_argument("--truth-command", action="store_true", help="print how the truth is made, and leave")
    args = parser.parse_args()
    if args.truth_command:
        settings = " ".join(f"--set {setting}" for setting in settings_of(args.scenario))
        print(f"python benchmarks/ground_truth.py {args.scenario} --rollouts 100000 {settings}")
        return
    loaded = load(args.scenario, settings_of(args.scenario))
    truth = table2_page.ground_truth(ROOT / "docs" / "ground-truth", loaded)
    archive = ROOT / "docs" / f"table2-{truth['scenario']}.zip"
    kept.unpack(archive, args.results)
    todo = [
        cell
        for cell in cells(args.scenario, truth)
        if re.search(args.only, cell.file) and not (args.results / cell.file).exists()
    ]
    if todo and not args.report_only:
        end = time.monotonic() + 60.0 * args.minutes
        tasks = [(args.results, cell, end) for cell in todo]
        with multiprocessing.get_context("spawn").Pool(args.workers) as pool:
            for done, line in enumerate(pool.imap_unordered(run, tasks), 1):
                print(f"{done}/{len(tasks)}  {line}", flush=True)
    study = table2_page.read(args.results, truth)
    if study.scenario != PUBLISHED:
        if args.keep:
            kept.pack(archive, args.results, f"{study.digest[:8]}-*.json")
        text = table2_page.page_of_scene(study, tuple(SCENE_METHODS))
        pages.put(ROOT / "docs" / f"table2-{study.scenario}.md", text, args.results)
    elif pages.put(ROOT / "docs" / "table2.md", table2_page.page(study), args.results):
        table2_figures.draw(study, ROOT / "docs" / "table2")


if __name__ == "__main__":
    main()
