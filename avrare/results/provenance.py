"""Origin of a run: command, budget, versions of Python and of the scenario's repository."""

from __future__ import annotations

import platform
import sys
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from avrare.base.errors import UsageError
from avrare.base.stored_files import read_json
from avrare.estimation.plan.budget import Budget
from avrare.results.checkout import describe_checkout
from avrare.results.stored_results import RUN_AGAIN
from avrare.scenario.schema import Scenario


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
        paid = None if budget is None else f"{budget.kind}={budget.amount!r}"
        date = datetime.now(UTC).replace(microsecond=0)
        return Provenance(tuple(sys.argv), paid, platform.python_version(), commit or "", changed, date)

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
