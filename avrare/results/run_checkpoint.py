"""Checkpoint of ``avrare run``: one for all scenarios of a run, in the run folder."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from avrare.base.errors import AvrareError, ExitCode, UsageError
from avrare.base.files import explain_file_errors, write_atomic
from avrare.estimation.budget import Budget
from avrare.estimation.checkpoint import FOLDER, SCENARIO, Checkpoint, read_index
from avrare.results.reader import RunFolder, read_run_folder
from avrare.scenario.fingerprint import fingerprint
from avrare.scenario.load import load
from avrare.scenario.schema import Scenario
from avrare.scenario.yaml import dump


@contextmanager
def begin(
    out: Path, scenarios: Sequence[Scenario], budget: Budget | None, resume: bool
) -> Iterator[Checkpoint]:
    """Create, or resume if asked to, the checkpoint of a run in ``out``, and hold its lock."""
    folder = out / FOLDER
    if len(scenarios) > 1 and any(one.name == FOLDER for one in scenarios):
        raise UsageError(
            f"{folder}: reserved for the checkpoint, but a scenario has the same name",
            "run the scenario by itself, or rename it",
        )
    if not resume and read_index(folder) is not None:
        _remove_without_chunks(folder)
    paths = {one.name: str(Path(one.path).resolve()) for one in scenarios}
    with Checkpoint.open(folder, _task(scenarios, budget), {"paths": paths}).held() as checkpoint:
        with explain_file_errors(f"{folder}: cannot save a checkpoint here"):
            for one in scenarios:
                (folder / one.name).mkdir(exist_ok=True)
                write_atomic(folder / one.name / SCENARIO, dump(one.resolved).encode(), durable=True)
        try:
            yield checkpoint
        except AvrareError as error:
            refused = error.exit_code in (ExitCode.USAGE, ExitCode.PLUGIN)
            if refused and not checkpoint.chunks:
                checkpoint.remove()
            raise


def _remove_without_chunks(folder: Path) -> None:
    with Checkpoint(folder, {}).held() as old:
        if old.chunks:
            resume = f"avrare run --resume {folder.parent} resumes it"
            raise UsageError(
                f"{folder.parent}: contains an interrupted run",
                f"{resume}; else remove {folder} or choose another --out",
            )
        old.remove()


def _task(scenarios: Sequence[Scenario], budget: Budget | None) -> dict[str, Any]:
    # the fingerprint comes last in a list of differences, as it explains least
    identities = {
        one.name: {**one.resolved, "versions": one.versions, "fingerprint": fingerprint(one)}
        for one in scenarios
    }
    return {"scenarios": identities, "budget": budget and f"{budget.kind}={budget.amount!r}"}


def saved_scenarios(out: Path, overrides: Sequence[str], estimator: str | None) -> list[Scenario]:
    """Return the scenarios of the checkpoint in ``out``; empty where there is none."""
    index = read_index(out / FOLDER)
    names = index["task"].get("scenarios", {}) if index else {}
    paths = index["about"].get("paths", {}) if index else {}
    if not all((out / FOLDER / name / SCENARIO).exists() for name in names):
        return []  # killed before it started
    loaded = [load(out / FOLDER / name / SCENARIO, overrides, estimator) for name in names]
    return [replace(one, path=str(paths.get(one.name, one.path))) for one in loaded]


def saved_budget(out: Path) -> Budget | None:
    """Return the budget of the checkpoint in ``out``, None where there is none."""
    index = read_index(out / FOLDER)
    return Budget.parse(index["task"].get("budget")) if index else None


def finished_results(
    out: Path, scenarios: Sequence[Scenario], overrides: Sequence[str] = (), estimator: str | None = None,
    budget: Budget | None = None,
) -> list[dict[str, Any]]:  # fmt: skip
    """Return the contents of the result.json files of a finished run; empty where it is not finished.

    They must be of these scenarios, or without any, of its own ones, which ``overrides`` and ``estimator``
    must not change; and of this budget if one is given.
    """
    if read_index(out / FOLDER) is not None:
        return []
    single = out / "result.json"
    files = [single] if single.exists() else sorted(out.glob("*/result.json"))
    runs = [read_run_folder(file.parent) for file in files]
    if not scenarios and (overrides or estimator):
        scenarios = [load(run.path / SCENARIO, overrides, estimator) for run in runs]
    wanted = {one.name: (fingerprint(one), one.seed) for one in scenarios}
    found = {run.result.scenario: (run.result.fingerprint, run.result.seed) for run in runs}
    if scenarios and runs and wanted != found:
        raise UsageError(f"{out}: contains the result of another run", "choose another folder")
    if runs and budget is not None and budget != (before := _recorded_budget(runs[0])):
        described = "its own options" if before is None else f"{before.kind}={before.amount:g}"
        raise UsageError(
            f"{out}: this run is finished, with a budget of {described}",
            "choose another folder for another budget",
        )
    return [run.content for run in runs]


def _recorded_budget(run: RunFolder) -> Budget | None:
    try:
        return Budget.parse(run.provenance.budget)
    except UsageError:  # a damaged provenance.json must not keep a finished run from being shown
        return None
