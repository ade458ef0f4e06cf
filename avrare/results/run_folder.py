"""Writer of run folders: result, resolved scenario, provenance and rollouts, each file written atomically."""

from __future__ import annotations

import json
import platform
import subprocess
import sys
from collections.abc import Sequence
from contextlib import suppress
from datetime import UTC, datetime
from itertools import count
from pathlib import Path
from typing import Any

from avrare.base.files import explain_file_errors, write_text
from avrare.estimation.budget import Budget
from avrare.estimation.result import Result
from avrare.results.stored_rollouts import write_failures, write_rollouts
from avrare.scenario.fingerprint import fingerprint
from avrare.scenario.schema import Scenario
from avrare.scenario.yaml import dump


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


def remove_empty(folder: Path) -> None:
    """Remove a run folder and the folders in it, as far as they are empty."""
    for path in [*sorted(folder.rglob("*"), reverse=True), folder]:
        with suppress(OSError):
            path.rmdir()


def document(scenario: Scenario, results: Sequence[Result]) -> dict[str, Any]:
    """Return the content of result.json."""
    return {
        "schema": 1,
        "scenario": scenario.name,
        "fingerprint": fingerprint(scenario),
        "seed": scenario.seed,
        "versions": scenario.versions,
        "estimates": [result.to_dict() for result in results],
    }


def provenance(scenario: Scenario, budget: Budget | None = None) -> dict[str, Any]:
    """Return the origin of a result: date, command, budget, Python, and commit of the scenario."""
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
    """Write result.json, the resolved scenario, provenance.json, rollouts.npz and, if any, failures.npz."""
    hint = "free some disk space and --resume the run, or choose another --out"
    with explain_file_errors(f"{folder}: cannot write the result", hint):
        write_text(folder / "scenario.yaml", dump(scenario.resolved))
        write_text(folder / "provenance.json", json.dumps(provenance(scenario, budget), indent=2) + "\n")
        write_failures(folder, results)
        write_rollouts(folder, results)
        write_text(folder / "result.json", json.dumps(content, indent=2) + "\n")
