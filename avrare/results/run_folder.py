"""Writer of run folders: result, scenario, provenance, rollouts and checkpoint; every file is atomic."""

from __future__ import annotations

import json
import platform
import sys
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from datetime import UTC, datetime
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from avrare.base.atomic_files import explain_file_errors, remove_torn, write_text
from avrare.base.errors import AvrareError, ExitCode, UsageError
from avrare.base.stored_files import digest, read_json, seal, write_arrays
from avrare.estimation.budget import Budget
from avrare.estimation.checkpoint import FOLDER, INDEX, SCENARIO, Checkpoint, read_index, resume_hint
from avrare.estimation.result import Result
from avrare.results.checkout import describe_checkout
from avrare.results.reader import (
    FAILURE_FIELDS,
    FAILURES_FILE,
    ROLLOUTS_FILE,
    RUN_AGAIN,
    SAMPLE_LAW,
    RunFolder,
    read_run_folder,
)
from avrare.results.stored_causes import ATTRIBUTION_FILE, KINDS_FILE
from avrare.scenario.fingerprint import comparable, fingerprint
from avrare.scenario.load import load
from avrare.scenario.schema import Scenario
from avrare.scenario.yaml import dump

_DERIVED = (KINDS_FILE, ATTRIBUTION_FILE, "report.html", "nominal.png", "worst_*.png")
"""Patterns of the files that are made from a result: they do not belong to the next one in its folder."""
_MAX_SAMPLES = 100_000
"""Stored robustness values of a specification: those of its first rollouts."""


def choose(out: str | Path, name: str, several: bool) -> Path:
    """Make the folder of one scenario of a run: ``out``, or a folder in it when there are several."""
    folder = Path(out) / name if several else Path(out)
    with explain_file_errors(f"{folder}: cannot make this folder", "choose another --out"):
        folder.mkdir(parents=True, exist_ok=True)
    return folder


def fresh(names: Sequence[str]) -> Path:
    """Make a new folder under ``runs/`` for a run of these scenarios."""
    name = names[0] if len(names) == 1 else f"{len(names)}-scenarios"
    stem = f"{name}-{datetime.now():%Y%m%d-%H%M%S}"
    with explain_file_errors(f"runs/{stem}: cannot make this folder", "choose another --out"):
        for number in count(1):  # two runs may begin in the same second
            folder = Path("runs", stem if number == 1 else f"{stem}-{number}")
            with suppress(FileExistsError):
                folder.mkdir(parents=True)
                break
    return folder


def refuse_links(folder: Path) -> None:
    """Raise a ``UsageError`` if there is a link in a folder: files elsewhere would be written or removed."""
    for path in folder.rglob("*"):
        if path.is_symlink():
            text = f"{path}: is a link; a run is resumed in a folder of its own files only"
            raise UsageError(text, "replace it by a copy, or start afresh in another folder")


def _refuse_others(out: Path, scenarios: Sequence[Scenario]) -> None:
    """Raise a ``UsageError`` if a folder has results that a run of these scenarios would not replace.

    They would be taken for this run's.
    """
    own = {out / one.name if len(scenarios) > 1 else out: one.name for one in scenarios}
    for file in [*out.glob("result.json"), *sorted(out.glob("*/result.json"))]:
        folder, found = file.parent, None
        with suppress(UsageError):  # a damaged one can be replaced
            found = read_json(file, RUN_AGAIN).get("scenario")
        replaced = folder in own and found in (None, own[folder])
        separate = folder != out and folder not in own and folder.name != found
        if not (replaced or separate):
            text = f"{folder}: contains the result of another run" + (f", of {found}" if found else "")
            raise UsageError(text, "choose another folder, or remove this one")


def remove_empty(folder: Path) -> None:
    """Remove a run folder and the folders in it, as far as they are empty."""
    for path in [*sorted(folder.rglob("*"), reverse=True), folder]:
        with suppress(OSError):
            path.rmdir()


def document(scenario: Scenario, results: Sequence[Result]) -> dict[str, Any]:
    """Return the content of result.json, with its checksum and the digests of scenario and artifacts."""
    content = {
        "schema": 1,
        "scenario": scenario.name,
        "fingerprint": fingerprint(scenario),
        "seed": scenario.seed,
        "versions": scenario.versions,
        "estimates": [result.to_dict() for result in results],
        "files": {
            name: digest(text)
            for name, text in {SCENARIO: dump(scenario.resolved), **_encode_artifacts(results)}.items()
        },
    }
    return seal(content)


def provenance(scenario: Scenario, budget: Budget | None = None) -> dict[str, Any]:
    """Return the origin of a result: date, command, budget, Python, and commit of the scenario."""
    commit, changed = describe_checkout(Path(scenario.path).resolve().parent)
    return {
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "command": sys.argv,
        "budget": None if budget is None else f"{budget.kind}={budget.amount!r}",
        "python": platform.python_version(),
        "commit": commit,
        "uncommitted_changes": changed,
    }


def write(
    folder: Path, scenario: Scenario, content: dict[str, Any], results: Sequence[Result] = (),
    budget: Budget | None = None,
) -> None:  # fmt: skip
    """Write a run folder: result, resolved scenario, provenance, rollouts, failures and artifacts.

    Files of an earlier result in the folder that this one does not write are removed.
    """
    hint = "free some disk space and --resume the run, or choose another --out"
    with explain_file_errors(f"{folder}: cannot write the result", hint):
        artifacts = _encode_artifacts(results)
        _remove_stale(folder, {SCENARIO, *artifacts})
        write_text(folder / "scenario.yaml", dump(scenario.resolved))
        write_text(folder / "provenance.json", json.dumps(provenance(scenario, budget), indent=2) + "\n")
        write_failures(folder, results)
        _write_rollouts(folder, results)
        for name, text in artifacts.items():
            write_text(folder / name, text)
        write_text(folder / "result.json", json.dumps(content, indent=2) + "\n")


@contextmanager
def begin_checkpoint(
    out: Path, scenarios: Sequence[Scenario], budget: Budget | None, resume: bool,
    check: Mapping[str, Any] | None = None,
) -> Iterator[Checkpoint]:  # fmt: skip
    """Create, or resume if asked to, the checkpoint of a run in ``out``, and hold its lock.

    ``check`` is what else must be equal to resume `avrare check`.
    """
    folder = out / FOLDER
    if len(scenarios) > 1 and any(one.name == FOLDER for one in scenarios):
        raise UsageError(
            f"{folder}: reserved for the checkpoint, but a scenario has the same name",
            "run the scenario by itself, or rename it",
        )
    if resume:
        refuse_links(out)
    else:
        _refuse_others(out, scenarios)
        if read_index(folder) is not None:
            _remove_without_chunks(folder)
    paths = {one.name: str(Path(one.path).resolve()) for one in scenarios}
    files = {f"{one.name}/{SCENARIO}": dump(one.resolved).encode() for one in scenarios}
    task = _task(scenarios, budget) | ({"check": check} if check is not None else {})
    with Checkpoint.open(folder, task, {"paths": paths}, files).held() as checkpoint:
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
            resume = resume_hint(folder.parent)
            raise UsageError(
                f"{folder.parent}: contains an interrupted run",
                f"{resume}; else remove {folder} or choose another --out",
            )
        old.remove()


def _task(scenarios: Sequence[Scenario], budget: Budget | None) -> dict[str, Any]:
    # the fingerprint comes last in a list of differences, as it explains least
    identities = {
        one.name: {**comparable(one), "versions": one.versions, "fingerprint": fingerprint(one)}
        for one in scenarios
    }
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
    for index in [] if single.exists() else sorted(out.glob(f"*/{FOLDER}/{INDEX}")):
        inside = index.parent.parent
        raise UsageError(f"{inside}: contains an interrupted run of its own", resume_hint(inside))
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
    if runs:  # a process killed after it had finished may have left these
        Checkpoint(out / FOLDER, {}).remove()
        remove_torn(out)
    return [run.content for run in runs]


def _recorded_budget(run: RunFolder) -> Budget | None:
    try:
        return Budget.parse(run.provenance.budget)
    except UsageError:  # a damaged provenance.json must not keep a finished run from being shown
        return None


def write_failures(folder: Path, results: Sequence[Result]) -> None:
    """Write the failing tapes of all results; remove the file where there are none.

    Arrays ``SPECIFICATION.noise`` (F, steps + 1, noise_size), ``.robustness`` (F,) and ``.count`` (), and
    where the estimator gives them ``.weights`` (F,) and ``.ancestors`` (F, 2).
    """
    arrays = {
        f"{result.specification}.{field}": np.asarray(getattr(result.failures, field))
        for result in results
        if len(result.failures.robustness)
        for field in (*FAILURE_FIELDS, *SAMPLE_LAW)
        if getattr(result.failures, field) is not None
    }
    if arrays:
        write_arrays(folder / FAILURES_FILE, arrays, compress=False)
    else:
        (folder / FAILURES_FILE).unlink(missing_ok=True)  # left by an earlier run in the same folder


def _encode_artifacts(results: Sequence[Result]) -> dict[str, str]:
    """Return the files that estimators leave, by name: each has an entry by specification."""
    entries: dict[str, dict[str, Any]] = {}
    for result in results:
        for name, artifact in result.artifacts.items():
            entries.setdefault(name, {})[result.specification] = artifact
    return {name: json.dumps(entries[name], indent=1) + "\n" for name in sorted(entries)}


def _remove_stale(folder: Path, written: Collection[str]) -> None:
    """Remove the files of an earlier result in ``folder``, but for those that are ``written`` next."""
    file, files = folder / "result.json", None
    if not file.exists():
        return
    with suppress(UsageError):  # a damaged result names no files
        files = read_json(file, RUN_AGAIN).get("files")
    names = [name for name in files if Path(name).name == name] if isinstance(files, dict) else []
    stale = [folder / name for name in names if name not in written]
    for path in [*stale, *(path for pattern in _DERIVED for path in folder.glob(pattern))]:
        if path.is_file():
            path.unlink()


def _write_rollouts(folder: Path, results: Sequence[Result]) -> None:
    # arrays SPECIFICATION.robustness (n,), .worst (steps + 1, noise_size) and .worst_robustness ()
    arrays: dict[str, NDArray[np.generic]] = {}
    for result in results:
        name = result.specification
        arrays[f"{name}.robustness"] = _to_single(result.robustness[:_MAX_SAMPLES])
        arrays[f"{name}.worst"] = np.asarray(result.worst.noise)
        arrays[f"{name}.worst_robustness"] = np.asarray(result.worst.robustness)
    write_arrays(folder / ROLLOUTS_FILE, arrays)


def _to_single(values: NDArray[np.float64]) -> NDArray[np.float32]:
    with np.errstate(over="ignore", under="ignore"):
        single = np.asarray(values).astype(np.float32)
    # a value that underflows keeps its sign, which tells failures apart
    lost = (single == 0.0) & (values != 0.0)
    tiny = np.copysign(np.finfo(np.float32).tiny, values)
    return np.where(lost, tiny, single).astype(np.float32)
