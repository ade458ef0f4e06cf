"""Stacks of four kinds: what `auto`, Monte Carlo and splitting cost for the same relative error.

    OMP_NUM_THREADS=1 python -m benchmarks.rare_stacks [--minutes 60] [--seeds 20] [--only TEXT] [--keep]
        [--report-only]

A cell is a case (see ``benchmarks.rare_events``) and an estimator. Each result is a line of
benchmarks/results/rare_stacks/CELL.jsonl; what is there is not made again, and `--keep` writes the lines into
docs/rare-events/stacks.zip, from which a clone begins. The table of docs/rare-events.md is written in any
case. Monte Carlo's cost follows from the probability. What `auto` leaves to Monte Carlo is answered by the
known probability (``studies/from_truth.py``).
"""

from __future__ import annotations

import time
import warnings
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import avrare
from benchmarks.studies import from_truth, kept, pages, stack_costs
from benchmarks.studies.levels import read_case
from benchmarks.studies.stack_costs import Costs, Outcome

ROOT = Path(__file__).parents[1]
KEPT = ROOT / "docs" / "rare-events" / "stacks.zip"
PAGE = ROOT / "docs" / "rare-events.md"
AUTO = {"relative_error": 0.2, "rollouts": 300_000}
_WITHIN = "specifications.perches.stl=eventually[0,66 samples] (abs(x) + abs(z) <= 0.06)"
"""Not 5 cm, as the truth counts: 63 of its rollouts come no nearer than this."""
_SMALL = {"particles": 60, "discard": 6, "runs": 5}


@dataclass(frozen=True)
class Stack:
    """A case, and the options of splitting that suit its price.

    Attributes:
        name: For people.
        case: Of ``benchmarks.rare_events``.
        seeds: Most results of splitting; those of `auto` are as many as are asked for.
        ams: Options of splitting; 10 runs by default, as a goal in relative error may take 320.
        settings: Changes of the scenario, KEY=VALUE.
    """

    name: str
    case: str
    seeds: int = 1000
    ams: dict[str, Any] = field(default_factory=dict)
    settings: tuple[str, ...] = ()


STACKS = (
    Stack("double integrator", "double_integrator:clear"),
    Stack("glider, noisy elevator", "glider_actuator:perches"),
    Stack("glider, within 6 cm", "glider_actuator:perches=6.3e-5", settings=(_WITHIN,)),
    Stack("merge with lidar", "merge_lidar:keeps_up=0.0084", 10, _SMALL),
)


def cells() -> Iterator[tuple[Stack, str, str]]:
    """Yield stack, estimator and the name of a cell's file."""
    for stack in STACKS:
        for name in ("auto", "ams"):
            yield stack, name, f"{stack.name.replace(' ', '_').replace(',', '')}-{name}"


def estimate(stack: Stack, estimator: str, seed: int) -> Outcome:
    """Return a result of a cell."""
    problem, truth = read_case(stack.case, stack.settings)
    began = time.process_time()
    if estimator == "auto":
        own = 1000 * zlib.crc32(stack.case.encode()) + seed  # what is answered would be the same draws
        result = from_truth.estimate(problem, truth, own, **AUTO)
    else:
        result = avrare.estimate(problem, estimator, seed=seed, **stack.ams)
    chosen = "is, climb" if "climb" in result.diagnostics else result.estimator
    tried = result.diagnostics.get("choice", {"tried": []})["tried"]
    return Outcome(
        seed, truth, chosen, result.probability, *result.interval, result.relative_error,
        result.simulated_steps / problem.steps,
        result.diagnostics.get("learning_rollouts", 0) + sum(one["rollouts"] for one in tried),
        tuple(result.health), round(time.process_time() - began, 1),
    )  # fmt: skip


def work(results: Path, seeds: int, only: str, minutes: float) -> None:
    """Run what is missing, seed by seed, until the time is up."""
    ends = time.monotonic() + 60.0 * minutes
    for seed in range(seeds):
        for stack, estimator, name in cells():
            file = results / f"{name}.jsonl"
            enough = estimator != "auto" and seed >= stack.seeds
            if enough or only not in name or seed in (one.seed for one in stack_costs.read(file)):
                continue
            if time.monotonic() > ends:
                return
            kept.add(file, estimate(stack, estimator, seed))


def main() -> None:
    """Run what is missing, and write the table."""
    results = ROOT / "benchmarks" / "results" / "rare_stacks"
    args = kept.parser(__doc__, KEPT, results, "glider").parse_args()
    kept.unpack(KEPT, args.results)
    warnings.simplefilter("ignore", avrare.HealthWarning)
    if not args.report_only:
        work(args.results, args.seeds, args.only, args.minutes)
    if args.keep:
        kept.pack(KEPT, args.results)
    found: dict[str, dict[str, Costs]] = {}
    for stack, estimator, name in cells():
        outcomes = stack_costs.read(args.results / f"{name}.jsonl")
        if outcomes:
            found.setdefault(stack.name, {})[estimator] = Costs(outcomes)
    text = pages.fill(PAGE.read_text(encoding="utf-8"), "stacks", stack_costs.table(found))
    PAGE.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
