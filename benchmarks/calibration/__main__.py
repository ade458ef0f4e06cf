"""The calibration benchmark: how often is a rare-event tool's interval wrong, and what does an answer cost?

    python -m benchmarks.calibration.environments      # once: the tools, each in an environment of its own
    python -m benchmarks.calibration [--quick] [--only REGEX] [--seeds 3] [--workers 2]

Each answer is a cell, a line of the tool's file in the results folder; what is there is not made again, so a
run may be stopped and go on. A results folder that is not there begins with the kept cells. Writes
the table of docs/calibration.md and the files and figures beside it; ``--keep`` packs the cells into
docs/calibration/cells.zip.
"""

from __future__ import annotations

import argparse
import itertools
import os
import re
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from benchmarks.calibration import cells, report
from benchmarks.calibration.environments import interpreter
from benchmarks.calibration.problems import problems
from benchmarks.calibration.runner import Runner
from benchmarks.calibration.tools import RECOMMENDED, TOOLS, Tool
from benchmarks.studies import kept

BUDGETS = (1_000, 10_000, 100_000)
"""Budgets of the full run; at the largest there is one answer of a tool to a problem."""
QUICK_BUDGETS, QUICK_MINUTES, QUICK_SECONDS = (10_000,), 30.0, 10.0
RESULTS = Path(__file__).parents[1] / "results" / "calibration"


def main(argv: Sequence[str] | None = None) -> None:
    """Make the cells that are missing, then write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="one budget, the first setting, 30 minutes")
    parser.add_argument("--only", default="", help='regular expression on "tool problem": "ams.*walk"')
    parser.add_argument("--seeds", type=int, help="answers of each tool to a problem (as in the full run)")
    parser.add_argument("--budgets", default="", help="such as 1000,10000")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--minutes", type=float, help="end after so many, whatever is missing")
    parser.add_argument("--seconds", type=float, help="CPU seconds of an answer at most (120)")
    parser.add_argument("--results", type=Path, default=RESULTS)
    parser.add_argument("--report-only", action="store_true")
    parser.add_argument("--no-report", action="store_true", help="make cells alone")
    parser.add_argument("--keep", action="store_true", help=f"pack the cells into {report.KEPT.name}")
    args = parser.parse_args(argv)
    kept.unpack(report.KEPT, args.results)
    if not args.report_only:
        budgets = tuple(int(float(one)) for one in args.budgets.split(",") if one)
        keys = wanted(
            args.seeds, budgets or (QUICK_BUDGETS if args.quick else BUDGETS), args.quick, args.only
        )
        minutes = args.minutes or (QUICK_MINUTES if args.quick else 1e9)
        limit = args.seconds or (QUICK_SECONDS if args.quick else 120.0)
        make(keys, args.results, args.workers, minutes, limit)
    if args.keep:
        kept.pack(report.KEPT, args.results)
    if not args.no_report:
        report.write(args.results)


def planned(tool: Tool, setting: str, budget: int) -> int:
    """Return the answers of a tool to a problem in the full run: fewer where they are dear or a variant's."""
    if setting != RECOMMENDED or budget == BUDGETS[-1]:
        return 1
    return 3 if budget >= tool.dear else 10


def wanted(seeds: int | None, budgets: Sequence[int], quick: bool, only: str) -> Iterator[cells.Key]:
    """Yield the keys, seed by seed, so that an end at any time leaves all tools and problems alike."""
    pairs = [
        (tool, setting, budget, planned(tool, setting, budget) if seeds is None else seeds)
        for budget in budgets for tool in TOOLS.values() for setting in tool.settings
        if not (quick and setting != RECOMMENDED)
    ]  # fmt: skip
    for seed in range(max(count for *_, count in pairs)):
        for (tool, setting, budget, count), problem in itertools.product(pairs, problems().values()):
            chosen = re.search(only, f"{tool.name} {problem.name}")
            if seed < count and chosen and not tool.unable(problem):
                yield tool.name, setting, problem.name, budget, seed


def make(keys: Iterator[cells.Key], folder: Path, workers: int, minutes: float, limit: float) -> None:
    """Make the cells that are missing or had less time, in so many workers of each environment at most."""
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    kept_cells = cells.read(folder)
    known = {cell.key: cell for cell in kept_cells if cell.time_limit >= limit}
    seconds = {cell.question: cell.seconds for cell in kept_cells if cell.seed == 0}
    hopeless = {cell.question for cell in known.values() if cell.hopeless}
    missing = [key for key in keys if key not in known]
    absent = {TOOLS[key[0]].environment for key in missing if not interpreter(TOOLS[key[0]].environment)}
    if absent:
        print(f"not installed, so left out: {', '.join(sorted(absent))}")
    missing = [key for key in missing if TOOLS[key[0]].environment not in absent]
    end = time.monotonic() + 60.0 * minutes
    print(f"{len(missing)} cells are missing, {len(known)} are there", flush=True)
    with ThreadPoolExecutor(workers) as pool:
        shares = [missing[row::workers] for row in range(workers)]
        for future in [
            pool.submit(Runner(folder, limit, hopeless, seconds).run, share, end) for share in shares
        ]:
            future.result()


if __name__ == "__main__":
    main()
