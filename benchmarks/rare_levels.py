"""The lane change at levels that its truth knows: what `auto` takes, and what an old proposal saves.

    OMP_NUM_THREADS=1 python -m benchmarks.rare_levels [--minutes 60] [--seeds 20] [--only TEXT] [--keep]
        [--report-only]

A cell is a rule, a level, a relative error to reach and how: `auto`, or `reused`, which is `is` with the
proposal (and the route of its climb) that the `auto` of the same seed has learned. Cells are run seed by
seed, cheap ones first, each result a line of benchmarks/results/rare_levels/CELL.jsonl; what is there is not
made again. `--keep` writes the lines into docs/rare-events/levels.zip, from which a clone begins. The table
of docs/rare-events.md is written in any case. Learned proposals stay in the results folder: without its
proposal a seed is not reused.

Pilot and Monte Carlo of `auto` are answered by the truth (``studies/from_truth.py``), so results that it
leaves to Monte Carlo cost only what was tried in vain.
"""

from __future__ import annotations

import json
import time
import warnings
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import avrare
from avrare import Problem
from avrare_estimators.importance.proposal_file import FILE, ProposalFile
from benchmarks.prune_proposal import failing_tapes, gain
from benchmarks.studies import from_truth, kept, level_table
from benchmarks.studies.level_table import Outcome
from benchmarks.studies.levels import Level, read_level, truth_file

ROOT = Path(__file__).parents[1]
KEPT = ROOT / "docs" / "rare-events" / "levels.zip"
PAGE = ROOT / "docs" / "rare-events.md"
SCENARIO = "lane_change"
ERRORS = (0.2, 0.1)
RARE = (1e-3, 1e-4, 1e-5)
RULES: dict[str, tuple[float | None, ...]] = {
    "safe_distance": (None,),
    "no_collision": RARE,
    "no_abrupt_braking": RARE,
    "left_traffic": RARE,
    "traffic_flow": RARE,
}
"""Levels of each rule; None is the rule itself. The truth keeps the tail below 1e-3."""
ROLLOUTS = 300_000
"""Most of a result; Monte Carlo needs 102,000 at 1e-3 for 10 %."""


@dataclass(frozen=True)
class Cell:
    """A rule at a level, an error to reach, and how: `auto` or `reused`."""

    rule: str
    level: float | None
    error: float
    how: str

    @property
    def name(self) -> str:
        """Name of its file."""
        level = f"{self.level:.0e}" if self.level else "own"
        return f"{self.rule}-{level}-{self.error:g}-{self.how}"

    def seed(self, number: int) -> int:
        """Return the seed of a result: of this cell alone, so that cells are independent."""
        return 1000 * zlib.crc32(self.name.encode()) + number


def cells() -> Iterator[Cell]:
    """Yield the cells, cheap ones first: by what Monte Carlo would cost."""
    work = ((1.0 / ((level or 1e-2) * error**2), rule, level, error)
            for rule, levels in RULES.items() for level in levels for error in ERRORS)  # fmt: skip
    for _, rule, level, error in sorted(work, key=lambda one: one[0]):
        yield Cell(rule, level, error, "auto")
        yield Cell(rule, level, error, "reused")


def estimate(cell: Cell, number: int, proposals: Path) -> Outcome | None:
    """Return a result of a cell, or None where the proposal to reuse is not there."""
    problem, truth = read_level(SCENARIO, cell.rule, cell.level)
    learned = proposals / f"{cell.name.rpartition('-')[0]}-{number}.json"
    began = time.process_time()
    options: dict[str, Any] = {"relative_error": cell.error, "rollouts": ROLLOUTS}
    if cell.how == "auto":
        result = from_truth.estimate(problem, truth, cell.seed(number), **options)
        content = result.artifacts.get(FILE)
        if content is not None:
            learned.write_text(json.dumps({problem.names[0]: content}), encoding="utf-8")
    elif learned.exists():
        result = avrare.estimate(problem, "is", seed=cell.seed(number), learned=str(learned), **options)
    else:
        return None
    chosen = "is, climb" if "climb" in result.diagnostics else result.estimator
    tried = result.diagnostics.get("choice", {"tried": []})["tried"]
    return Outcome(
        number, truth, chosen, result.probability, *result.interval, result.relative_error,
        result.simulated_steps / problem.steps,
        result.diagnostics.get("learning_rollouts", 0) + sum(one["rollouts"] for one in tried),
        true_gain(problem, cell, learned) if chosen == "is" else None,
        tuple(result.health), round(time.process_time() - began, 1),
    )  # fmt: skip


def true_gain(problem: Problem, cell: Cell, learned: Path) -> float:
    """Return what a proposal gains over Monte Carlo on the failures of the truth, which it has not seen."""
    (mixture,) = ProposalFile.read(learned).mixtures.values()
    (monitor,) = problem.monitors
    level = monitor.level if isinstance(monitor, Level) else 0.0
    return round(gain(mixture, failing_tapes(truth_file(SCENARIO), cell.rule, level, mixture.shape)), 2)


def work(results: Path, seeds: int, only: str, minutes: float) -> None:
    """Run what is missing, seed by seed, until the time is up."""
    ends, proposals = time.monotonic() + 60.0 * minutes, results / "learned"
    proposals.mkdir(exist_ok=True)
    for number in range(seeds):
        for cell in cells():
            file = results / f"{cell.name}.jsonl"
            if only not in cell.name or number in (one.seed for one in level_table.read(file)):
                continue
            if time.monotonic() > ends:
                return
            found = estimate(cell, number, proposals)
            if found is not None:
                kept.add(file, found)


def main() -> None:
    """Run what is missing, and write the table."""
    results = ROOT / "benchmarks" / "results" / "rare_levels"
    args = kept.parser(__doc__, KEPT, results, "no_collision-1e-03-0.2").parse_args()
    kept.unpack(KEPT, args.results)
    warnings.simplefilter("ignore", avrare.HealthWarning)
    if not args.report_only:
        work(args.results, args.seeds, args.only, args.minutes)
    if args.keep:
        kept.pack(KEPT, args.results)
    found = [(cell, level_table.read(args.results / f"{cell.name}.jsonl")) for cell in cells()]
    rows = [level_table.row(one.rule, one.error, one.how, some, args.seeds) for one, some in found if some]
    level_table.put(PAGE, "levels", [*level_table.head(), *rows])


if __name__ == "__main__":
    main()
