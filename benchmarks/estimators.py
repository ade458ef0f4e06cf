"""Is splitting unbiased, does its interval cover, and what does it cost beside another library's?

    OMP_NUM_THREADS=1 python benchmarks/estimators.py [--workers 2] [--only PATTERN] [--results DIR]

Three studies on the reference problems, cut into cells of many independent runs and cells into blocks, each a
file in the results folder: what is there is not run again, so the study may be stopped and resumed. Writes
docs/estimators.md from what there is. The whole takes about six CPU hours.

- bias: mean over truth of 1,000 runs for four settings of N and K;
- coverage: 1,000 intervals of 10 runs each;
- peers: OpenTURNS' subset sampling at as many model evaluations, 500 repetitions each.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import sys
from pathlib import Path

from studies import cells, pages, peers, tables

REPORT = Path(__file__).parent.parent / "docs" / "estimators.md"


def main(argv: list[str]) -> None:
    """Run what is missing, then write the report."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--only", default="", help="cells whose name holds this")
    parser.add_argument("--results", type=Path, default=Path(__file__).parent / "results" / "estimators")
    parser.add_argument("--report-only", action="store_true")
    args = parser.parse_args(argv)
    args.results.mkdir(parents=True, exist_ok=True)
    if not args.report_only:
        run_missing(args.results, args.only, args.workers)
    pages.put(REPORT, tables.report(args.results), args.results)


def run_missing(results: Path, only: str, workers: int) -> None:
    """Run every block that has no file yet, the cheap cells first."""
    blocks = [block for block in [*cells.blocks(), *peers.blocks()] if only in block.cell]
    missing = [(results, block) for block in blocks if not (results / block.file).exists()]
    print(f"{len(blocks) - len(missing)} of {len(blocks)} blocks are there", flush=True)
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    with multiprocessing.get_context("spawn").Pool(workers, maxtasksperchild=20) as pool:
        for done, line in enumerate(pool.imap_unordered(cells.run, missing), start=1):
            print(f"{done}/{len(missing)}  {line}", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
