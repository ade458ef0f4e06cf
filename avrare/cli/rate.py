"""``avrare rate``: rates of rule violations per hour and km, over the scenes of a catalogue."""

from __future__ import annotations

import argparse
import json
import shlex
from collections.abc import Sequence
from dataclasses import asdict
from datetime import datetime
from pathlib import Path
from typing import Any, Literal

from avrare.analysis.rates.catalogue import Catalogue, load_catalogue
from avrare.analysis.rates.rates import CatalogueRates, Counts, compute, divide
from avrare.base.errors import Interrupted, UsageError
from avrare.base.stored_files import read_json
from avrare.cli.options import display
from avrare.cli.output import print_warnings, say, write_files
from avrare.cli.run import estimate_run
from avrare.estimation.budget import Budget
from avrare.report.html.rate_page import render_rates
from avrare.report.terminal.console import make_console
from avrare.report.terminal.rate_table import print_rates
from avrare.results import run_folder as rundir
from avrare.rollout.executors.interruption import Stopping
from avrare.rollout.loaded_scenario import LoadedScenario
from avrare.scenario.safe_mode import is_safe

Phase = Literal["pilot", "scenes"]
_BUDGET = "budget.json"


def execute(args: argparse.Namespace) -> int:
    """Run the pilot, divide the budget, run the scenes, report, and return the exit code of the verdict."""
    catalogue = load_catalogue(args.catalogue)
    budget = catalogue.budget(Budget.parse(args.budget))
    out = _out_folder(args, catalogue)
    try:
        with Stopping() as stop:
            rates = _estimate(args, catalogue, budget, out, stop)
    except (Interrupted, KeyboardInterrupt) as error:
        hint = f"resume with {_resume_command(args, out)}"
        raise Interrupted("interrupted, finished chunks are saved", hint) from error
    files = {"rate.json": json.dumps(rates.to_dict(), indent=2) + "\n", "report.html": render_rates(rates)}
    write_files(out, files)
    if args.json:
        print(files["rate.json"], end="")
    else:
        print_rates(make_console(display(args)), rates, quiet=display(args) == "quiet")
        say(f"results in {out}: rate.json, report.html, a run folder of each scene in scenes")
    return int(rates.exit_code)


def _resume_command(args: argparse.Namespace, out: Path) -> str:
    budget = ["--budget", str(args.budget)] if args.budget is not None else []
    safe = ["--safe"] if is_safe() else []
    return shlex.join(["avrare", "rate", args.catalogue, "--resume", str(out), *budget, *safe])


def _out_folder(args: argparse.Namespace, catalogue: Catalogue) -> Path:
    if args.resume is not None:
        if args.out is not None and Path(args.out).resolve() != Path(args.resume).resolve():
            raise UsageError("--out cannot be combined with --resume", "results go to the folder of --resume")
        if not Path(args.resume).is_dir():
            raise UsageError(f"--resume {args.resume}: no such folder")
        rundir.refuse_links(Path(args.resume))
        return Path(args.resume)
    out = Path(args.out or f"runs/{catalogue.document.name}-{datetime.now():%Y%m%d-%H%M%S}")
    if any((out / name).exists() for name in ("pilot", "scenes", "rate.json", _BUDGET)):
        raise UsageError(
            f"{out}: there is a catalogue's run in this folder", "--resume it, or choose another"
        )
    return out


def _estimate(
    args: argparse.Namespace, catalogue: Catalogue, budget: Budget, out: Path, stop: Any
) -> CatalogueRates:
    document = catalogue.document
    count = len(document.scenes)
    steps = [catalogue.scenario(index, "scenes", 1).steps for index in range(count)]
    divide(catalogue, budget, steps, [dict.fromkeys(catalogue.rules, (0, 1, 0))] * count)  # enough?
    _keep_budget(budget, out)
    pilot = _run_phase(args, catalogue, "pilot", [document.pilot] * count, out, stop)
    rollouts = divide(catalogue, budget, steps, [_counts(content) for content in pilot])
    contents = _run_phase(args, catalogue, "scenes", rollouts, out, stop)
    broken = [
        entry.name
        for entry, content in zip(document.scenes, contents, strict=True)
        if any("errors" in one["health"] for one in content["estimates"])
    ]
    return compute(catalogue, [_counts(content) for content in contents], broken)


def _keep_budget(budget: Budget, out: Path) -> None:
    # Shares of another budget are other runs: they would be refused one by one, without this reason.
    path = out / _BUDGET
    if path.exists():
        kept = read_json(path, "choose another --out")
        if kept != asdict(budget):
            text = f"{out}: it was begun with another budget, {kept.get('kind')}={kept.get('amount')}"
            raise UsageError(text, "--resume it with that --budget, or choose another --out")
        return
    write_files(out, {_BUDGET: json.dumps(asdict(budget)) + "\n"})


def _run_phase(
    args: argparse.Namespace,
    catalogue: Catalogue,
    phase: Phase,
    rollouts: Sequence[int],
    out: Path,
    stop: Any,
) -> list[dict[str, Any]]:
    contents = []
    for index, (entry, count) in enumerate(zip(catalogue.document.scenes, rollouts, strict=True)):
        scenario = catalogue.scenario(index, phase, count)
        if phase == "pilot":
            print_warnings(scenario.warnings)
        folder = rundir.choose(out / phase, entry.name, True)
        found = rundir.finished_results(folder, [scenario])
        if not found:
            with rundir.begin_checkpoint(folder, [scenario], None, args.resume is not None) as checkpoint:
                results = estimate_run(LoadedScenario(scenario), args, None, checkpoint, stop)
                found = [rundir.document(scenario, results)]
                rundir.write(folder, scenario, found[0], results)
                checkpoint.remove()
        missing = set(catalogue.rules) - {one["specification"] for one in found[0]["estimates"]}
        if missing:
            raise UsageError(
                f"{folder}: its result has no estimate of {', '.join(sorted(missing))}",
                "remove this folder and --resume: its rollouts are run again",
            )
        contents.append(found[0])
    return contents


def _counts(content: dict[str, Any]) -> Counts:
    return {
        one["specification"]: (int(one["failures"]), int(one["rollouts"]), int(one["errors"]))
        for one in content["estimates"]
    }
