"""The checkpoint of ``avrare run``: one for all scenarios of a run, in the run's folder."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from avrare.errors import AvrareError, ExitCode, UsageError
from avrare.estimation.budget import Budget
from avrare.record.checkpoint import FOLDER, SCENARIO, Checkpoint, read_index, write_durably
from avrare.scenario.fingerprint import fingerprint
from avrare.scenario.load import load
from avrare.scenario.schema import Scenario
from avrare.scenario.yaml import dump


@contextmanager
def begin(
    out: Path, scenarios: Sequence[Scenario], budget: Budget | None, resume: bool
) -> Iterator[Checkpoint]:
    """Begin the run's checkpoint in ``out``, or go on with it; nobody else can while it is entered.

    Raises:
        UsageError: It is that of another run, there is one that is not to be gone on with, somebody is at
            work on it, or the folder cannot be written to.
    """
    folder = out / FOLDER
    if len(scenarios) > 1 and any(one.name == FOLDER for one in scenarios):
        raise UsageError(
            f"{folder}: is kept for the checkpoint, and a scenario has the same name",
            "run it alone, or give it another name",
        )
    if not resume and read_index(folder) is not None:
        _clear(folder)
    with Checkpoint.open(folder, _task(scenarios, budget), _paths(scenarios)).held() as checkpoint:
        try:
            for one in scenarios:
                (folder / one.name).mkdir(exist_ok=True)
                write_durably(folder / one.name / SCENARIO, dump(one.resolved).encode())
        except OSError as error:
            raise UsageError(f"{folder}: cannot save a checkpoint here: {error.strerror}") from None
        try:
            yield checkpoint
        except AvrareError as error:
            refused = error.exit_code in (ExitCode.USAGE, ExitCode.PLUGIN)
            if refused and not checkpoint.chunks:
                checkpoint.remove()
            raise


def _clear(folder: Path) -> None:
    """Take a checkpoint away that holds nothing yet, and nobody's."""
    with Checkpoint(folder, {}).held() as old:
        if old.chunks:
            raise UsageError(
                f"{folder.parent}: holds a run that was interrupted",
                f"avrare run --resume {folder.parent} goes on with it; else remove {folder} or choose "
                "another --out",
            )
        old.remove()


def _task(scenarios: Sequence[Scenario], budget: Budget | None) -> dict[str, Any]:
    """What must be equal to go on; the fingerprint comes last, as it tells least."""
    described = {
        one.name: {**one.resolved, "versions": one.versions, "fingerprint": fingerprint(one)}
        for one in scenarios
    }
    return {"scenarios": described, "budget": budget and f"{budget.kind}={budget.amount!r}"}


def _paths(scenarios: Sequence[Scenario]) -> dict[str, Any]:
    return {"paths": {one.name: str(Path(one.path).resolve()) for one in scenarios}}


def saved_scenarios(out: Path, overrides: Sequence[str], estimator: str | None) -> list[Scenario]:
    """The scenarios of the checkpoint in ``out``; empty where there is none.

    Args:
        out: Folder of the run.
        overrides: Laid over them, as by ``load``.
        estimator: As by ``load``.

    Raises:
        ScenarioError: One of them cannot be loaded.
        UsageError: The checkpoint cannot be read.
    """
    index = read_index(out / FOLDER)
    names = index["task"].get("scenarios", {}) if index else {}
    paths = index["about"].get("paths", {}) if index else {}
    if not all((out / FOLDER / name / SCENARIO).exists() for name in names):
        return []  # killed before it began
    loaded = [load(out / FOLDER / name / SCENARIO, overrides, estimator) for name in names]
    return [replace(one, path=str(paths.get(one.name, one.path))) for one in loaded]


def saved_budget(out: Path) -> Budget | None:
    """The budget of the checkpoint in ``out``, None where there is none.

    Raises:
        UsageError: The checkpoint cannot be read.
    """
    index = read_index(out / FOLDER)
    return Budget.parse(index["task"].get("budget")) if index else None


def finished_results(
    out: Path, scenarios: Sequence[Scenario], overrides: Sequence[str] = (), estimator: str | None = None,
    budget: Budget | None = None,
) -> list[dict[str, Any]]:  # fmt: skip
    """The contents of the result.json of a run that has come to its end; empty where it has not.

    Args:
        out: Folder of the run.
        scenarios: That it should be of; empty where nobody says.
        overrides: Where ``scenarios`` is empty: laid over its own, which must stay what they are.
        estimator: Likewise.
        budget: That it should have had; None where nobody says.

    Raises:
        ScenarioError: ``overrides`` do not fit.
        UsageError: They are of other scenarios, or cannot be read.
    """
    if read_index(out / FOLDER) is not None:
        return []
    paths = [path] if (path := out / "result.json").exists() else sorted(out.glob("*/result.json"))
    try:
        contents = {path: dict(json.loads(path.read_text(encoding="utf-8"))) for path in paths}
    except (OSError, ValueError, TypeError) as error:
        raise UsageError(f"{out}: its result cannot be read: {error}", "choose another folder") from None
    if not scenarios and (overrides or estimator):
        scenarios = [load(path.with_name(SCENARIO), overrides, estimator) for path in paths]
    wanted = {one.name: (fingerprint(one), one.seed) for one in scenarios}
    found = {one.get("scenario"): (one.get("fingerprint"), one.get("seed")) for one in contents.values()}
    if scenarios and contents and wanted != found:
        raise UsageError(f"{out}: holds the result of another run", "choose another folder")
    if contents and budget is not None and budget != (before := _budget_of(next(iter(contents)).parent)):
        told = "its own options" if before is None else f"{before.kind}={before.amount:g}"
        raise UsageError(
            f"{out}: this run is finished, with a budget of {told}",
            "choose another folder for another budget",
        )
    return list(contents.values())


def _budget_of(folder: Path) -> Budget | None:
    """The budget of a finished run."""
    try:
        provenance = json.loads((folder / "provenance.json").read_text(encoding="utf-8"))
        return Budget.parse(provenance.get("budget"))
    except (OSError, ValueError, AttributeError):
        return None
