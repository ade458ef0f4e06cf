"""The run folder: what a run leaves behind, each file written whole or not at all."""

from __future__ import annotations

import json
import platform
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from avrare.errors import UsageError
from avrare.estimation.budget import Budget
from avrare.estimation.result import Result
from avrare.record.failures import write_failures
from avrare.record.rollouts import write_rollouts
from avrare.record.whole import write_text
from avrare.scenario.fingerprint import fingerprint
from avrare.scenario.schema import Scenario
from avrare.scenario.yaml import dump

SCHEMA = 1


def choose(out: str | Path, name: str, several: bool) -> Path:
    """The folder of one scenario of a run: ``out``, or a folder inside it when there are several.

    Raises:
        UsageError: It cannot be made.
    """
    folder = Path(out) / name if several else Path(out)
    with _refused(folder):
        folder.mkdir(parents=True, exist_ok=True)
    return folder


def fresh(names: Sequence[str]) -> Path:
    """A new folder under ``runs/`` for a run of these scenarios.

    Raises:
        UsageError: It cannot be made.
    """
    stamp = datetime.now().strftime("%Y%m%d-%H%M%S")
    folder = Path("runs") / f"{names[0] if len(names) == 1 else f'{len(names)}-scenarios'}-{stamp}"
    with _refused(folder):
        return _make_new(folder)


def remove_empty(folder: Path) -> None:
    """Take a run's folders away as far as nothing is in them."""
    for path in [*sorted(folder.rglob("*"), reverse=True), folder]:
        with suppress(OSError):
            path.rmdir()


@contextmanager
def _refused(folder: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise UsageError(
            f"{folder}: cannot make this folder: {error.strerror}", "choose another --out"
        ) from error


def _make_new(folder: Path) -> Path:
    """A folder of nobody else's: two runs may begin in the same second."""
    one, number = folder, 1
    while True:
        try:
            one.mkdir(parents=True)
            return one
        except FileExistsError:
            number += 1
            one = folder.with_name(f"{folder.name}-{number}")


def document(scenario: Scenario, results: Sequence[Result]) -> dict[str, Any]:
    """The content of result.json."""
    return {
        "schema": SCHEMA,
        "scenario": scenario.name,
        "fingerprint": fingerprint(scenario),
        "seed": scenario.seed,
        "versions": scenario.versions,
        "estimates": [result.to_dict() for result in results],
    }


def provenance(scenario: Scenario, budget: Budget | None = None) -> dict[str, Any]:
    """Where a result comes from: when, command, budget, Python, and the scenario's commit, if it has one."""
    folder = Path(scenario.path).resolve().parent
    changes = _git(folder, "status", "--porcelain", "--untracked-files=no")
    return {
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "command": sys.argv,
        "budget": None if budget is None else f"{budget.kind}={budget.amount!r}",
        "python": platform.python_version(),
        "commit": _git(folder, "rev-parse", "HEAD"),
        "uncommitted_changes": None if changes is None else bool(changes),
    }


def _git(folder: Path, *words: str) -> str | None:
    try:
        answer = subprocess.run(
            ["git", *words], cwd=folder, capture_output=True, text=True, timeout=10, check=True
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return answer.stdout.strip()


def write(
    folder: Path, scenario: Scenario, content: dict[str, Any], results: Sequence[Result] = (),
    budget: Budget | None = None,
) -> None:  # fmt: skip
    """Write result.json, the resolved scenario, provenance.json, rollouts.npz and, if any, failures.npz.

    Raises:
        UsageError: The folder cannot be written to.
    """
    try:
        write_text(folder / "scenario.yaml", dump(scenario.resolved))
        write_text(folder / "provenance.json", json.dumps(provenance(scenario, budget), indent=2) + "\n")
        write_failures(folder, results)
        write_rollouts(folder, results)
        write_text(folder / "result.json", json.dumps(content, indent=2) + "\n")
    except OSError as error:
        raise UsageError(
            f"{folder}: cannot write the result: {error.strerror}",
            "make room and --resume the run, or choose another --out",
        ) from error
