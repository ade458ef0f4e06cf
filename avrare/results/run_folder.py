"""Folders of runs: chosen, refused where they hold another run, checkpointed, and passed to callbacks."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from datetime import datetime
from importlib.metadata import EntryPoint, entry_points
from itertools import count
from pathlib import Path

from avrare.base.atomic_files import explain_file_errors, remove_torn
from avrare.base.errors import UsageError
from avrare.base.stored_files import read_json
from avrare.estimation.loop.checkpoint import FOLDER, INDEX, SCENARIO, Checkpoint, read_index, resume_hint
from avrare.estimation.plan.budget import Budget
from avrare.plugin.registry import VARIABLE
from avrare.results.run import RESULT, Run
from avrare.results.stored_results import RUN_AGAIN
from avrare.scenario.fingerprint import fingerprint, identify
from avrare.scenario.load import load
from avrare.scenario.schema import Scenario
from avrare.scenario.yaml import dump


def make_folder(out: str | Path, name: str, several: bool) -> Path:
    """Make the folder of one scenario of a run: ``out``, or a folder in it when there are several."""
    folder = Path(out) / name if several else Path(out)
    with explain_file_errors(f"{folder}: cannot make this folder", "choose another folder"):
        folder.mkdir(parents=True, exist_ok=True)
    return folder


def make_new_folder(names: Sequence[str]) -> Path:
    """Make a new folder under ``runs/`` for a run of these scenarios."""
    name = names[0] if len(names) == 1 else f"{len(names)}-scenarios"
    stem = f"{name}-{datetime.now():%Y%m%d-%H%M%S}"
    with explain_file_errors(f"runs/{stem}: cannot make this folder", "choose another folder"):
        for number in count(1):  # two runs may begin in the same second
            folder = Path("runs", stem if number == 1 else f"{stem}-{number}")
            with suppress(FileExistsError):
                folder.mkdir(parents=True)
                break
    return folder


def refuse_links(paths: Iterable[Path]) -> None:
    """Raise a ``UsageError`` if one of the paths is a link: files elsewhere would be written or removed."""
    for path in paths:
        if path.is_symlink():
            text = f"{path}: is a link; a run is resumed in a folder of its own files only"
            raise UsageError(text, "replace it by a copy, or start afresh in another folder")


def _refuse_others(out: Path, scenarios: Sequence[Scenario]) -> None:
    """Raise a ``UsageError`` if a folder has results that a run of these scenarios would not replace.

    They would be taken for this run's.
    """
    folders = {out / scenario.name if len(scenarios) > 1 else out: scenario.name for scenario in scenarios}
    for file in [*out.glob("result.json"), *sorted(out.glob("*/result.json"))]:
        folder, stored = file.parent, None
        with suppress(UsageError):  # a damaged one can be replaced
            stored = read_json(file, RUN_AGAIN).get("scenario")
        replaced = folder in folders and stored in (None, folders[folder])
        separate = folder != out and folder not in folders and folder.name != stored
        if not (replaced or separate):
            text = f"{folder}: contains the result of another run" + (f", of {stored}" if stored else "")
            raise UsageError(text, "choose another folder, or remove this one")


def remove_empty(folder: Path) -> None:
    """Remove a run folder and the folders in it, as far as they are empty."""
    for path in [*sorted(folder.rglob("*"), reverse=True), folder]:
        with suppress(OSError):
            path.rmdir()


@contextmanager
def begin_checkpoint(
    out: Path,
    scenarios: Sequence[Scenario],
    budget: Budget | None,
    resume: bool,
    check: Mapping[str, object] | None = None,
) -> Iterator[Checkpoint]:
    """Create, or resume if asked to, the checkpoint of a run in ``out``, and hold its lock.

    ``check`` must be equal, too, to resume `avrare check`.
    """
    folder = out / FOLDER
    if len(scenarios) > 1 and any(scenario.name == FOLDER for scenario in scenarios):
        raise UsageError(
            f"{folder}: reserved for the checkpoint, but a scenario has the same name",
            "run the scenario alone, or rename it",
        )
    if resume:
        refuse_links(out.rglob("*"))
    else:
        _refuse_others(out, scenarios)
        if read_index(folder) is not None:
            _remove_without_chunks(folder)
    paths = {scenario.name: str(Path(scenario.path).resolve()) for scenario in scenarios}
    files = {f"{scenario.name}/{SCENARIO}": dump(scenario.resolved).encode() for scenario in scenarios}
    task = _task(scenarios, budget) | ({"check": check} if check is not None else {})
    with Checkpoint.open(folder, task, {"paths": paths}, files).hold() as checkpoint:
        yield checkpoint


def _remove_without_chunks(folder: Path) -> None:
    with Checkpoint(folder, {}).hold() as old:
        if old.chunks:
            resume = resume_hint(folder.parent)
            raise UsageError(
                f"{folder.parent}: contains an interrupted run",
                f"{resume}; else remove {folder} or choose another folder",
            )
        old.remove()


def _task(scenarios: Sequence[Scenario], budget: Budget | None) -> dict[str, object]:
    identities = {scenario.name: identify(scenario) for scenario in scenarios}
    return {"scenarios": identities, "budget": budget and f"{budget.kind}={budget.amount!r}"}


def saved_scenarios(out: Path, overrides: Sequence[str], estimator: str | None) -> list[Scenario]:
    """Return the scenarios of the checkpoint in ``out``; empty where there is none."""
    index = read_index(out / FOLDER)
    names, paths = (index["task"].get("scenarios"), index["about"].get("paths")) if index else ({}, {})
    plain = isinstance(names, dict) and isinstance(paths, dict)
    if not plain or any(Path(name).name != name or name in ("", "..") for name in names):
        text = f"{out / FOLDER}: this is not the checkpoint of a run"
        raise UsageError(text, "give the scenario as well, or start afresh in another folder")
    if not all((out / FOLDER / name / SCENARIO).exists() for name in names):
        return []  # someone has removed a file: the command must name the scenario
    loaded = [load(out / FOLDER / name / SCENARIO, overrides, estimator) for name in names]
    return [replace(scenario, path=str(paths.get(scenario.name, scenario.path))) for scenario in loaded]


def saved_budget(out: Path) -> Budget | None:
    """Return the budget of the checkpoint in ``out``, None where there is none."""
    index = read_index(out / FOLDER)
    return Budget.parse(index["task"].get("budget")) if index else None


def read_finished(
    out: Path,
    scenarios: Sequence[Scenario],
    overrides: Sequence[str] = (),
    estimator: str | None = None,
    budget: Budget | None = None,
) -> list[Run]:
    """Read the runs of a finished folder; empty where it is not finished.

    They must be of these scenarios, or without any, of its own ones, which ``overrides`` and ``estimator``
    must not change; and of this budget if one is given.
    """
    if read_index(out / FOLDER) is not None:
        return []
    single = out / RESULT
    for index in [] if single.exists() else sorted(out.glob(f"*/{FOLDER}/{INDEX}")):
        inside = index.parent.parent
        raise UsageError(f"{inside}: contains an interrupted run of its own", resume_hint(inside))
    files = [single] if single.exists() else sorted(out.glob(f"*/{RESULT}"))
    runs = [Run.read(file.parent) for file in files]
    if not scenarios and (overrides or estimator):
        scenarios = [load(file.parent / SCENARIO, overrides, estimator) for file in files]
    identities = {scenario.name: (fingerprint(scenario), scenario.seed) for scenario in scenarios}
    if scenarios and runs and identities != {run.name: (run.fingerprint, run.seed) for run in runs}:
        raise UsageError(f"{out}: contains the result of another run", "choose another folder")
    if runs and budget is not None and budget != (before := _recorded_budget(runs[0])):
        described = "its own options" if before is None else f"{before.kind}={before.amount:g}"
        raise UsageError(
            f"{out}: this run is finished, with a budget of {described}",
            "choose another folder for another budget",
        )
    if runs:  # a process killed after it had finished may have left these
        Checkpoint(out / FOLDER, {}).remove()
        remove_torn(out)
    return runs


def _recorded_budget(run: Run) -> Budget | None:
    try:
        return Budget.parse(run.provenance.budget)
    except UsageError:  # a damaged provenance.json must not keep a finished run from being shown
        return None


GROUP = "avrare.results"
"""Entry points whose value is a function ``on_result(run: Run) -> str | None``."""


def call_back(run: Run) -> list[str]:
    """Call the callbacks of all installed distributions with a run that has been written.

    An exception becomes a line, and changes no exit code.

    Returns:
        Lines to show: the callbacks' texts, and the callbacks that failed.
    """
    lines = []
    for point in _find_allowed():
        try:
            said = point.load()(run)
        except (Exception, SystemExit) as error:
            lines.append(f"callback {point.name} failed: {type(error).__name__}: {error}")
        else:
            lines += [str(said)] if said else []
    return lines


def _find_allowed() -> list[EntryPoint]:
    names = os.environ.get(VARIABLE)
    allowed = None if names is None else {name.strip() for name in names.split(",")}
    points = sorted(entry_points(group=GROUP), key=lambda point: point.name)
    return [point for point in points if allowed is None or point.name in allowed]
