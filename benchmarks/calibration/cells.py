"""Cells: one answer of one tool to one problem, each a line of the tool's file."""

from __future__ import annotations

import json
import math
import re
from dataclasses import asdict, dataclass
from pathlib import Path

from benchmarks.studies import kept

_NOT_ASKED = "not asked, as seed 0 had "
PACE = 5.0
"""Least ratio that is assumed of the CPU seconds of an answer to those at a tenth of its budget."""
Question = tuple[str, str, str, int]
Key = tuple[str, str, str, int, int]


@dataclass(frozen=True)
class Cell:
    """One answer.

    Attributes:
        tool: Name of the tool with its method.
        version: Version of the tool.
        setting: Name of the setting.
        problem: Name of the problem.
        budget: Evaluations that it was given.
        seed: Its seed.
        estimate: Probability; None where it has no answer.
        low: Lower end of the interval; None where it states none.
        high: Upper end.
        warnings: What it warned of.
        evaluations: Evaluations that the black box counted.
        seconds: CPU time.
        reason: Why there is no answer, else empty.
    """

    tool: str
    version: str
    setting: str
    problem: str
    budget: int
    seed: int
    estimate: float | None
    low: float | None
    high: float | None
    warnings: tuple[str, ...]
    evaluations: float
    seconds: float
    reason: str

    @staticmethod
    def out_of_time(seconds: float) -> str:
        """Return the reason of a cell that was given up after so many CPU seconds."""
        return f"no answer within {seconds:.0f} CPU seconds"

    @staticmethod
    def not_asked(seconds: float) -> str:
        """Return the reason of a cell whose first seed was given up after so many CPU seconds."""
        return _NOT_ASKED + Cell.out_of_time(seconds)

    @staticmethod
    def too_slow(seconds: float) -> str:
        """Return the reason of a cell that took so many CPU seconds at a tenth of its budget."""
        return f"not asked, as a tenth of the budget took {seconds:.0f} CPU seconds"

    @property
    def time_limit(self) -> float:
        """CPU seconds that it had or would exceed; infinite where time is not why it has no answer."""
        if found := re.fullmatch(r"not asked, as a tenth of the budget took (\d+) CPU seconds", self.reason):
            return PACE * float(found[1])
        return self.patience

    @property
    def patience(self) -> float:
        """CPU seconds after which it was given up; infinite where that is not why it has no answer."""
        found = re.fullmatch(r"no answer within (\d+) CPU seconds", self.cause)
        return float(found[1]) if found else math.inf

    @property
    def cause(self) -> str:
        """Reason, which is that of seed 0 where the others were not asked."""
        return self.reason.removeprefix(_NOT_ASKED)

    @property
    def hopeless(self) -> bool:
        """Mark of a first seed that was given up for time: the other seeds are not asked."""
        return self.seed == 0 and math.isfinite(self.time_limit)

    @property
    def question(self) -> Question:
        """Key without the seed."""
        return self.tool, self.setting, self.problem, self.budget

    @property
    def key(self) -> Key:
        """Key that tells it from the others."""
        return *self.question, self.seed


def file_of(folder: Path, tool: str) -> Path:
    """Return the file of a tool's cells."""
    return folder / f"{tool.replace(' ', '-')}.jsonl"


def add(folder: Path, cell: Cell) -> None:
    """Append a cell to its file."""
    with file_of(folder, cell.tool).open("a", encoding="utf-8") as file:
        file.write(json.dumps(asdict(cell)) + "\n")


def read(folder: Path) -> list[Cell]:
    """Return all cells of a folder, the last of each key; a torn line is left out."""
    found: dict[Key, Cell] = {}
    for file in sorted(folder.glob("*.jsonl")):
        for fields in kept.lines(file):
            cell = Cell(**{**fields, "warnings": tuple(fields["warnings"])})
            found[cell.key] = cell
    return list(found.values())
