"""The loop over the specifications of a problem, each with its cross-check."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass

from avrare.estimation.combine.cross_check import add_cross_check
from avrare.estimation.loop.loop import Progress, run
from avrare.estimation.loop.preflight import Clearance, check_estimate
from avrare.estimation.plan.plan import Estimator, Journal, Settings
from avrare.estimation.result.doubts import answer_doubts
from avrare.estimation.result.result import Result
from avrare.rollout.executors.serial import SerialExecutor
from avrare.rollout.executors.work import Executor
from avrare.rollout.problem import Problem
from avrare.scenario.cross_check import CrossCheck

Watch = Callable[[str, Problem], AbstractContextManager[Progress | None]]
"""Called with a label and a problem as each estimate begins; gives its progress display."""


def show_nothing(label: str, problem: Problem) -> AbstractContextManager[None]:
    """Show no progress."""
    return nullcontext()


@dataclass(frozen=True)
class Execution:
    """Ways to run, show, save and stop estimates; no number depends on them.

    Attributes:
        start_executor: Builds the executor of each estimate.
        watch: Shows the progress of each estimate.
        journal: Gives the journal of an estimate by its name; None where nothing is saved.
        stop: Returns True once no further chunk is to begin.
    """

    start_executor: Callable[[], Executor] = SerialExecutor
    watch: Watch = show_nothing
    journal: Callable[[str], Journal | None] = lambda name: None
    stop: Callable[[], bool] | None = None

    def run(
        self, label: str, name: str, problem: Problem, estimator: Estimator, settings: Settings
    ) -> list[Result]:
        """Run one estimate: ``label`` stands in its progress display, ``name`` is that of its journal."""
        journal, executor = self.journal(name), self.start_executor()
        with self.watch(label, problem) as progress:
            return run(problem, estimator, executor, settings, progress, journal, self.stop)


def group_specifications(problem: Problem, estimator: Estimator) -> list[Problem]:
    """Return the problems that an estimator takes one after the other: all specifications, or each."""
    return problem.separate() if estimator.single else [problem]


def check_specifications(problem: Problem, estimator: Estimator, settings: Settings) -> list[Clearance]:
    """Return the clearance of each estimate of a problem's specifications.

    Raises:
        UsageError: One of them could not begin.
    """
    return [check_estimate(group, estimator, settings) for group in group_specifications(problem, estimator)]


def estimate_specifications(
    problem: Problem,
    estimator: Estimator,
    settings: Settings,
    execution: Execution,
    check: CrossCheck | None = None,
    *,
    title: str = "",
    note: str = "",
) -> Iterator[tuple[Problem, Result]]:
    """Yield the problem and the result of each specification.

    Args:
        problem: Problem with the specifications.
        estimator: Takes all of them in one pass where it can, else one after the other.
        settings: Settings of each estimate; the budget leaves room for its cross-check.
        execution: Runs the estimates.
        check: Options of the cross-check of each result, None for none.
        title: Label of an estimate of several specifications; by default their names.
        note: Text that is added to each label.
    """

    def run_check(problem: Problem, checker: Estimator, settings: Settings) -> Result:
        name = problem.names[0]
        label = f"{name}{note}  cross-check by {checker.name}"
        # no specification has a "+" in its name
        return execution.run(label, f"{name}+check", problem, checker, settings)[0]

    for group in group_specifications(problem, estimator):
        names = group.names
        label = f"{(len(names) > 1 and title) or ', '.join(names)}{note}  {estimator.name}"
        results = execution.run(label, names[0], group, estimator, settings)
        for part, result in zip(group.separate(), results, strict=True):
            if check is not None:
                result = add_cross_check(part, result, check, settings, run_check)
            yield part, answer_doubts(result)
