"""Origin of a run: command, budget, versions of Python, and the commit of the scenario's repository."""

from __future__ import annotations

import os
import platform
import subprocess
import sys
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from avrare.base.errors import UsageError
from avrare.base.stored_files import read_json
from avrare.estimation.plan.budget import Budget
from avrare.results.stored_results import RUN_AGAIN
from avrare.scenario.schema import Scenario

_ENVIRONMENT = {
    "GIT_OPTIONAL_LOCKS": "0",  # nothing is written
    "GIT_NO_LAZY_FETCH": "1",
    "GIT_ALLOW_PROTOCOL": "none",  # for versions that do not know the line above
    "GIT_TERMINAL_PROMPT": "0",
}


def describe_checkout(folder: Path) -> tuple[str | None, bool | None]:
    """Return the commit of a folder, and whether there are uncommitted changes; None where not known.

    The settings of an untrusted repository may name programs. Its filters cannot be switched off, so nothing
    is said about changes where it has any of its own.
    """
    code, commit = _git(folder, "rev-parse", "HEAD")
    if code != 0:
        return None, None
    filtering = r"^filter\..*\.(clean|smudge|process)$"
    code, filters = _git(folder, "config", "--show-scope", "--get-regexp", filtering)
    own_scopes = ("local\t", "worktree\t")
    if code not in (0, 1) or any(line.startswith(own_scopes) for line in filters.splitlines()):
        return commit, None
    code, changes = _git(folder, "status", "--porcelain", "--untracked-files=no", "--ignore-submodules=dirty")
    return commit, bool(changes) if code == 0 else None


def _git(folder: Path, *words: str) -> tuple[int, str]:
    off = ("core.fsmonitor=false", "core.hooksPath=/dev/null")
    command = ["git", *(word for option in off for word in ("-c", option)), *words]
    try:
        answer = subprocess.run(
            command,
            cwd=folder,
            env=os.environ | _ENVIRONMENT,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            errors="replace",
            timeout=10,
            check=False,
        )
    except (OSError, subprocess.SubprocessError):
        return -1, ""
    return answer.returncode, answer.stdout.strip()


@dataclass(frozen=True)
class Provenance:
    """Origin of a run; empty where it is not recorded.

    ``budget`` is ``KIND=AMOUNT``, None where the estimator's own options decided. ``commit`` and
    ``uncommitted_changes`` are of the scenario's folder.
    """

    command: tuple[str, ...] = ()
    budget: str | None = None
    python: str | None = None
    commit: str = ""
    uncommitted_changes: bool | None = False
    date: datetime | None = None

    @staticmethod
    def collect(scenario: Scenario, budget: Budget | None = None) -> Provenance:
        """Return the origin of the results that this process makes of a scenario."""
        commit, changed = describe_checkout(Path(scenario.path).resolve().parent)
        budget_text = None if budget is None else f"{budget.kind}={budget.amount:.15g}"
        date = datetime.now(UTC).replace(microsecond=0)
        return Provenance(
            tuple(sys.argv), budget_text, platform.python_version(), commit or "", changed, date
        )

    @staticmethod
    def read(file: Path) -> tuple[Provenance, tuple[str, ...]]:
        """Read provenance.json; a damaged one is empty, and a line says so."""
        try:
            content = read_json(file, RUN_AGAIN) if file.is_file() else {}
        except UsageError as error:
            return Provenance(), (error.message,)
        budget, python, command = (content.get(key) for key in ("budget", "python", "command"))
        changed = content.get("uncommitted_changes")
        provenance = Provenance(
            command=tuple(map(str, command)) if isinstance(command, list) else (),
            budget=str(budget) if budget else None,
            python=None if python is None else str(python),
            commit=str(content.get("commit") or ""),
            uncommitted_changes=changed if isinstance(changed, bool) else None,
            date=_date(content.get("date")),
        )
        return provenance, ()

    def to_dict(self) -> dict[str, object]:
        """Return the content of provenance.json."""
        date = None if self.date is None else self.date.isoformat(timespec="seconds")
        return {**vars(self), "command": list(self.command), "commit": self.commit or None, "date": date}


def _date(text: object) -> datetime | None:
    try:
        return datetime.fromisoformat(str(text)).astimezone(UTC)
    except (ValueError, OverflowError):
        return None
