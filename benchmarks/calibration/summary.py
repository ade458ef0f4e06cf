"""Summary: what the cells of a tool on a problem, at a budget, say of it."""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from benchmarks.calibration.cells import Cell
from benchmarks.calibration.problems import problems
from benchmarks.calibration.problems.problem import Problem

FACTOR = 3.0
"""An interval that misses the truth by more than this factor is far off."""
LEAST_TOOLS = 5
"""Tools of others that a problem was asked of often enough, at a budget, to speak of a first one."""
LEAST_ANSWERS = 3
"""Answers by which a tool may be judged: the error of two may be small by chance."""


@dataclass(frozen=True)
class Row:
    """Cells of a tool with a setting on a problem at a budget.

    Attributes:
        tool: Name of the tool.
        setting: Name of the setting.
        problem: The problem.
        budget: Evaluations that were given.
        cells: One for each seed.
    """

    tool: str
    setting: str
    problem: Problem
    budget: int
    cells: tuple[Cell, ...]

    @cached_property
    def answers(self) -> list[Cell]:
        """Cells with a probability."""
        return [cell for cell in self.cells if cell.estimate is not None]

    @cached_property
    def stated(self) -> list[Cell]:
        """Cells with an interval."""
        return [cell for cell in self.answers if cell.low is not None]

    @cached_property
    def ratios(self) -> np.ndarray:
        """Estimates over the truth."""
        return np.array([cell.estimate for cell in self.answers], dtype=float) / self.problem.probability

    def share(self, hits: int, of: int) -> float:
        """Return a share, NaN of nothing."""
        return hits / of if of else math.nan

    @property
    def answered(self) -> float:
        """Share of the cells with a probability and an interval."""
        return self.share(len(self.stated), len(self.cells))

    @property
    def mean(self) -> float:
        """Mean estimate over the truth."""
        return float(self.ratios.mean()) if len(self.ratios) else math.nan

    @property
    def mean_error(self) -> float:
        """Standard error of the mean, the truth's included."""
        if len(self.ratios) < 2:
            return math.nan
        scatter = float(self.ratios.std(ddof=1)) / math.sqrt(len(self.ratios))
        return math.hypot(scatter, self.mean * self.problem.error / self.problem.probability)

    @property
    def evaluations(self) -> float:
        """Mean number of evaluations, of the cells that were counted to their end."""
        counted = [cell.evaluations for cell in self.cells if cell.evaluations]
        return float(np.mean(counted)) if counted else math.nan

    @property
    def square_error(self) -> float:
        """Mean squared relative error."""
        return float(((self.ratios - 1.0) ** 2).mean()) if len(self.ratios) else math.nan

    @property
    def cost(self) -> float:
        """Mean squared relative error times evaluations; of Monte Carlo it is (1 - p) / p."""
        return self.square_error * self.evaluations

    @property
    def covers(self) -> float:
        """Share of the intervals that hold the truth."""
        truth = self.problem.probability
        return self.share(sum(c.low <= truth <= c.high for c in self.stated), len(self.stated))  # type: ignore[operator]

    @property
    def widths(self) -> list[float]:
        """Upper over lower end of each interval; infinite where it begins at 0."""
        return [cell.high / cell.low if cell.low else math.inf for cell in self.stated]  # type: ignore[operator]

    @property
    def width(self) -> float:
        """Median width of the intervals."""
        return float(np.median(self.widths)) if self.stated else math.nan

    @property
    def warned(self) -> float:
        """Share of the cells with a warning."""
        return self.share(sum(bool(cell.warnings) for cell in self.cells), len(self.cells))

    @property
    def wrong(self) -> int:
        """Number of cells that are confidently wrong: no warning, and far off."""
        return sum(far_off(cell, self.problem.probability) and not cell.warnings for cell in self.stated)

    @property
    def wrong_share(self) -> float:
        """Share of the cells that are confidently wrong."""
        return self.share(self.wrong, len(self.cells))

    @property
    def seconds(self) -> float:
        """Median CPU time."""
        return float(np.median([cell.seconds for cell in self.cells]))


def far_off(cell: Cell, truth: float) -> bool:
    """Return whether the interval misses the truth by more than the factor."""
    return cell.low is not None and cell.high is not None and (
        cell.high * FACTOR < truth or cell.low > truth * FACTOR
    )  # fmt: skip


def rows_of(cells: Iterable[Cell]) -> list[Row]:
    """Return the rows of cells; those of problems that are no more are left out."""

    def group(cell: Cell) -> tuple[str, str, str, int]:
        return cell.tool, cell.setting, cell.problem, cell.budget

    known = problems()
    ordered = sorted((cell for cell in cells if cell.problem in known), key=group)
    return [
        Row(tool, setting, known[name], budget, tuple(members))
        for (tool, setting, name, budget), members in itertools.groupby(ordered, key=group)
    ]


def best(rows: Sequence[Row]) -> Row | None:
    """Return the row of least cost among those that may be trusted, None where there is none."""
    good = [row for row in rows if trusted(row)]
    return min(good, key=lambda row: row.cost) if good else None


def compared(rows: Sequence[Row]) -> list[Row]:
    """Return the rows of problems that were asked often enough of enough tools to speak of a first one."""
    # Tools of other authors: ours, asked more often, would be first for want of competitors.
    others = [row for row in rows if len(row.cells) >= LEAST_ANSWERS and not row.tool.startswith("avrare")]
    asked = Counter(name for name, _ in {(row.problem.name, row.tool) for row in others})
    return [row for row in rows if asked[row.problem.name] >= LEAST_TOOLS]


def trusted(row: Row) -> bool:
    """Return whether the answers of a row may be trusted: answered, unbiased, covering, never wrong.

    With few seeds these are judged leniently: 3 standard errors, 80 % of the intervals, 90 % answered.
    """
    return (
        len(row.answers) >= LEAST_ANSWERS
        and row.answered >= 0.9
        and row.covers >= 0.8
        and row.wrong == 0
        and abs(row.mean - 1.0) <= 3.0 * row.mean_error + 0.02
    )
