"""Scope of the full run: budgets, and how many answers of a tool to a problem."""

from __future__ import annotations

from benchmarks.calibration.problems import problems
from benchmarks.calibration.tools import RECOMMENDED, TOOLS, Tool

BUDGETS = (1_000, 10_000, 100_000)
"""Budgets of the full run."""
_SEEDS, _DEAR_SEEDS, _LARGE = 10, 3, 100_000
"""Answers of a tool to a problem, those where they are dear, and the budget from which on there is one."""


def planned(tool: Tool, setting: str, budget: int) -> int:
    """Return the answers of a tool to a problem in the full run: fewer where they are dear or a variant's."""
    if setting != RECOMMENDED or budget >= _LARGE:
        return 1
    return _DEAR_SEEDS if budget >= tool.dear else _SEEDS


def possible() -> int:
    """Return the number of answers of the full run."""
    return sum(
        planned(tool, setting, budget) * sum(not tool.unable(problem) for problem in problems().values())
        for tool in TOOLS.values() for setting in tool.settings for budget in BUDGETS
    )  # fmt: skip
