"""Study of intervals that are confidently wrong, on problems that nothing was tuned on.

    OMP_NUM_THREADS=1 python benchmarks/untuned.py [--workers 2] [--only PATTERN] [--seeds 300]

Every estimator runs with its default options and many seeds on each of the 32 problems of
``studies/untuned_problems.py``. Every pair of problem and estimator is a file in the results folder with a
line for each seed: what is there is not run again, so the study may be stopped and resumed. A results folder
that is not there begins with the kept results, docs/untuned/results.zip; ``--keep`` writes them. Writes
docs/untuned.md.

A result is confidently wrong (CW) if it carries no warning and its 95 % interval misses the truth by more
than a factor of three.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import sys
import warnings
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

from studies import kept, pages
from studies.untuned_problems import untuned_names, untuned_problem

import avrare

REPORT = Path(__file__).parent.parent / "docs" / "untuned.md"
KEPT = REPORT.parent / "untuned" / "results.zip"
ESTIMATORS = ("ams", "ess", "ce")
FACTOR = 3.0
LEAST_COVERAGE, MOST_WARNED, LEAST_RESULTS = 0.93, 0.1, 40


@dataclass(frozen=True)
class Outcome:
    """One result of an estimator.

    Attributes:
        seed: Seed of the estimate.
        probability: Estimate.
        low: Lower end of the interval.
        high: Upper end.
        blind: Bound of the failures that the score does not lead to.
        rollouts: Cost.
        warnings: Names of the health warnings.
    """

    seed: int
    probability: float
    low: float
    high: float
    blind: float
    rollouts: int
    warnings: tuple[str, ...]

    def covers(self, truth: float) -> bool:
        """Return whether the interval covers the truth."""
        return self.low <= truth <= self.high

    def far_off(self, truth: float) -> bool:
        """Return whether the interval misses the truth by more than the factor."""
        return self.high * FACTOR < truth or self.low > truth * FACTOR


def main(argv: list[str]) -> None:
    """Run the seeds that are missing, then write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--only", default="", help="cells (problem-estimator) whose name holds this")
    parser.add_argument("--seeds", type=int, default=300, help="results of a cell")
    parser.add_argument("--results", type=Path, default=Path(__file__).parent / "results" / "untuned")
    parser.add_argument("--report-only", action="store_true")
    parser.add_argument("--keep", action="store_true", help=f"write the results into {KEPT.name}")
    args = parser.parse_args(argv)
    kept.unpack(KEPT, args.results)
    if not args.report_only:
        os.environ.setdefault("OMP_NUM_THREADS", "1")
        cells = [(name, args.results, args.seeds) for name in cell_names() if args.only in name]
        with multiprocessing.get_context("spawn").Pool(args.workers, maxtasksperchild=1) as pool:
            for done, line in enumerate(pool.imap_unordered(run_cell, cells), start=1):
                print(f"{done}/{len(cells)}  {line}", flush=True)
    if args.keep:
        kept.pack(KEPT, args.results)
    pages.put(REPORT, page(args.results), args.results)


def cell_names() -> Iterator[str]:
    """Yield the names of the cells; splitting has nothing to do on static problems."""
    for name in untuned_names():
        yield from (f"{name}-{kind}" for kind in ESTIMATORS if kind != "ams" or not name.startswith("static"))


def run_cell(task: tuple[str, Path, int]) -> str:
    """Run the seeds of a cell that its file lacks, and describe the cell in a line."""
    cell, results, seeds = task
    name, estimator = cell.rsplit("-", 1)
    untuned = untuned_problem(name)
    found = read(results / f"{cell}.jsonl")
    with (results / f"{cell}.jsonl").open("a", encoding="utf-8") as file, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for seed in sorted(set(range(seeds)) - {outcome.seed for outcome in found}):
            result = avrare.estimate(untuned.problem(), estimator, seed=seed)
            outcome = Outcome(
                seed, result.probability, *result.interval, result.blind_bound or 0.0, result.rollouts,
                tuple(result.health),
            )  # fmt: skip
            file.write(json.dumps(asdict(outcome)) + "\n")
            file.flush()
            found.append(outcome)
    return Cell.of(cell, found).row()


def read(file: Path) -> list[Outcome]:
    """Read the outcomes of a cell; a torn last line is left out."""
    return [Outcome(**{**fields, "warnings": tuple(fields["warnings"])}) for fields in kept.lines(file)]


@dataclass(frozen=True)
class Cell:
    """Results of an estimator on a problem.

    Attributes:
        name: Problem.
        estimator: Estimator.
        truth: Exact probability.
        outcomes: The results.
    """

    name: str
    estimator: str
    truth: float
    outcomes: list[Outcome]

    @staticmethod
    def of(cell: str, outcomes: list[Outcome]) -> Cell:
        """Return the cell of this name."""
        name, estimator = cell.rsplit("-", 1)
        return Cell(name, estimator, untuned_problem(name).probability, outcomes)

    @property
    def quiet(self) -> list[Outcome]:
        """Results without a warning."""
        return [outcome for outcome in self.outcomes if not outcome.warnings]

    @property
    def held(self) -> int:
        """Number of results without a warning whose interval covers the truth."""
        return sum(outcome.covers(self.truth) for outcome in self.quiet)

    @property
    def wrong(self) -> list[Outcome]:
        """Results that are confidently wrong."""
        return [outcome for outcome in self.quiet if outcome.far_off(self.truth)]

    @property
    def warned(self) -> float:
        """Share of the results with a warning."""
        return 1.0 - len(self.quiet) / len(self.outcomes)

    def row(self) -> str:
        """Return the cell's row of the table."""
        unsaid = [one for one in self.wrong if max(one.high, one.blind) * FACTOR < self.truth]
        size = len(self.outcomes)
        mean = sum(outcome.probability for outcome in self.outcomes) / size
        entries = (
            self.name,
            self.estimator,
            f"{self.truth:.2g}",
            str(size),
            f"{mean / self.truth:.2f}",
            _share(sum(outcome.covers(self.truth) for outcome in self.outcomes), size),
            _share(size - len(self.quiet), size),
            _share(self.held, len(self.quiet)),
            _share(len(self.wrong), size),
            _share(len(unsaid), size),
            f"{sum(outcome.rollouts for outcome in self.outcomes) / size:,.0f}",
        )
        return "| " + " | ".join(entries) + " |"


def _share(hits: int, size: int) -> str:
    return f"{100.0 * hits / size:.1f}" if size else ""


def goals(estimator: str, cells: list[Cell]) -> str:
    """Return the row of an estimator in the table of goals."""
    size, wrong = sum(len(cell.outcomes) for cell in cells), sum(len(cell.wrong) for cell in cells)
    cells = [cell for cell in cells if len(cell.outcomes) >= LEAST_RESULTS]
    blamed = [cell for cell in cells if cell.wrong]
    short = [cell for cell in cells if cell.held < LEAST_COVERAGE * len(cell.quiet)]
    loud = [cell for cell in cells if cell.warned > MOST_WARNED and cell.quiet and cell not in short]
    lists = (
        [f"{cell.name} ({len(cell.wrong)} of {len(cell.outcomes)})" for cell in blamed],
        [f"{cell.name} ({cell.held} of {len(cell.quiet)})" for cell in short],
        [f"{cell.name} ({cell.warned:.0%})" for cell in loud],
    )
    entries = (
        f"`{estimator}`",
        f"{size:,}",
        _share(wrong, size),
        *(", ".join(names) or "none" for names in lists),
    )
    return "| " + " | ".join(entries) + " |"


def page(results: Path) -> str:
    """Return the page."""
    found = ((name, read(results / f"{name}.jsonl")) for name in cell_names())
    cells = [Cell.of(name, outcomes) for name, outcomes in found if outcomes]
    lines = [
        "# Problems that nothing was tuned on",
        "",
        "Default options; written by `python benchmarks/untuned.py`. All shares are in percent. *CW*: no",
        "warning, and the 95 % interval misses the truth by more than a factor of three. *CW, unsaid*:",
        "beyond the bound for failures that the score does not lead to ([blind mass](blind-mass.md)), too.",
        "300 results a row are wanted; a row with fewer is not finished. For `ess`, `ce` and four rows of",
        "`ams` (units_100, units_1e4, units_three, units_rare) the warning `outliers`",
        "([blind mass](blind-mass.md)) was worked out apart from the results, with their seeds.",
        "",
        "The goals: CW at most 0.1 % over all and 1 % on any problem; unwarned results cover in at least",
        "93 %; at most 10 % are warned of where the unwarned ones are right. Below are the problems with",
        f"{LEAST_RESULTS} results and more that miss them. A warning of `ce` is right where four",
        "Gaussians do not describe the failures (an outlier in any step, hidden regimes, Boolean signals):",
        "it then prints the wide interval. So is `flat_part` wherever a part shows nothing before it fails.",
        "",
        "| estimator | results | CW over all | CW | unwarned cover in less than 93 % "
        "| warned of in more than 10 % |",
        "|---|---|---|---|---|---|",
    ]
    for estimator in ESTIMATORS:
        lines.append(goals(estimator, [cell for cell in cells if cell.estimator == estimator]))
    lines += [
        "",
        "| problem | estimator | p | results | mean/p | covers | warned | covers when unwarned | CW "
        "| CW, unsaid | rollouts |",
        "|---|---|---|---|---|---|---|---|---|---|---|",
        *(cell.row() for cell in cells),
    ]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    main(sys.argv[1:])
