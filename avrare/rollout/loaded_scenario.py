"""Loaded scenario: builds problems for Python callers, the command line and the workers."""

from __future__ import annotations

import os
from collections.abc import Sequence
from functools import cached_property, partial
from typing import Any

from avrare.base.errors import UsageError, did_you_mean
from avrare.driving import Scene
from avrare.logic import formula as logic
from avrare.logic.formula import FormulaMonitor
from avrare.protocols import Estimator
from avrare.rollout.child_process import run_guarded
from avrare.rollout.problem import Problem
from avrare.rollout.scores.progress_score import shape_of
from avrare.rollout.twin import Twin
from avrare.scenario.load import load as read_scenario
from avrare.scenario.safe_mode import safe_mode
from avrare.scenario.schema import Formula, Scenario, ScoreFormula
from avrare.stack.builder import Stack, build_block, build_stack
from avrare.stack.trial import refuse_violated_starts

AnyEstimator = Estimator[Any, Any, Any, Any, Any]


def load(path: str | os.PathLike[str], overrides: Sequence[str] = (), safe: bool = False) -> LoadedScenario:
    """Read and validate a scenario file; ``.problem(name)`` builds the stack.

    Args:
        path: YAML file.
        overrides: Settings as for ``--set``, for example ``["steps=20", "estimator.particles=50"]``; a
            string is a single one.
        safe: Refuse code outside installed plugins, and files outside the scenario's folder.

    Raises:
        ScenarioError: The file has problems; the message lists all of them with line and column.
    """
    with safe_mode(safe):
        return LoadedScenario(read_scenario(path, overrides))


def open_problem(
    subject: Problem | str | os.PathLike[str],
    specification: str | None = None,
    overrides: Sequence[str] = (),
    safe: bool = False,
) -> Problem:
    """Return the problem of one specification.

    Args:
        subject: Scenario file, or a problem.
        specification: Name; None: the only one.
        overrides: Settings of the file, as for ``--set``.
        safe: As for ``load``.

    Raises:
        UsageError: There are several specifications and none is named, or none has the name.
    """
    if not isinstance(subject, Problem):
        scenario = load(subject, overrides, safe)
        return scenario.problem(select_specification(scenario.specifications, specification, scenario.name))
    if overrides:
        raise UsageError("overrides are settings of a scenario file", "change the problem itself")
    name = type(subject.system).__name__
    return subject.subset([select_specification(subject.names, specification, name)])


def select_specification(names: Sequence[str], specification: str | None, place: str) -> str:
    """Return ``specification``, by default the only one of ``names``.

    Raises:
        UsageError: There are several, or ``place`` has none of that name.
    """
    if specification is None and len(names) > 1:
        raise UsageError("a specification must be named", f"one of: {', '.join(names)}")
    if specification is not None and specification not in names:
        text = f"{place}: unknown specification {specification!r}"
        raise UsageError(text, did_you_mean(specification, names))
    return names[0] if specification is None else specification


class LoadedScenario:
    """Scenario with its stack, which is built on first use; ``avrare.load`` returns one.

    Attributes:
        definition: The validated scenario.
    """

    def __init__(self, definition: Scenario) -> None:
        self.definition = definition

    @property
    def name(self) -> str:
        """Name of the scenario."""
        return self.definition.name

    @property
    def steps(self) -> int:
        """Number of steps of a rollout."""
        return self.definition.steps

    @property
    def specifications(self) -> tuple[str, ...]:
        """Names of the specifications."""
        return tuple(self.definition.specifications)

    @cached_property
    def stack(self) -> Stack:
        """Built parts; the noise-free start violates no specification."""
        stack = build_stack(self.definition)
        run_guarded(
            "its noise-free start", stack.loop, partial(refuse_violated_starts, self.definition, stack)
        )
        return stack

    @cached_property
    def twin(self) -> LoadedScenario | None:
        """The cheap twin, None where the scenario names none."""
        return None if self.definition.cheap is None else LoadedScenario(self.definition.cheap)

    @property
    def scene(self) -> Scene | None:
        """Road, sizes and names of a driving simulator, else None."""
        return self.stack.scene

    def problem(self, specification: str | Sequence[str]) -> Problem:
        """Build the problem of one specification, or of several to monitor in one pass."""
        names = (specification,) if isinstance(specification, str) else tuple(specification)
        for name in names:
            if name not in self.definition.specifications:
                raise UsageError(
                    f"scenario {self.name!r} has no specification {name!r}",
                    did_you_mean(name, self.definition.specifications),
                )
        return ScenarioProblem(self, names)

    def estimator(self) -> AnyEstimator:
        """Build the scenario's estimator."""
        return build_block(self.definition.estimator, self.scene, AnyEstimator)


class ScenarioProblem(Problem):
    """Problem that is pickled as its scenario and rebuilt in the worker."""

    def __init__(self, scenario: LoadedScenario, names: tuple[str, ...]) -> None:
        self.scenario = scenario
        stack, definition = scenario.stack, scenario.definition
        specifications = {name: stack.specifications[name] for name in names}
        score = _choose_score(scenario, names[0])
        super().__init__(
            stack.loop,
            specifications,
            definition.steps,
            score,
            chunk=definition.chunk,
            rollout_timeout=definition.rollout_timeout,
        )

    @property
    def twin(self) -> Twin | None:
        """Cheap stand-in that the scenario names, or that was given in Python."""
        twin = self.scenario.twin
        if self._twin is None and twin is not None:
            self._twin = Twin(twin.problem(self.names), self.scenario.definition.cheap_cost)
        return self._twin

    def subset(self, names: Sequence[str]) -> Problem:
        """Return the problem of some specifications, with the score of the first of them."""
        return self if tuple(names) == self.names else self.scenario.problem(names)

    def __reduce__(self) -> tuple[object, ...]:
        return _rebuild_problem, (self.scenario.definition, self.names, self.score, self._sizes)


def _rebuild_problem(definition: Scenario, names: tuple[str, ...], score: Any, sizes: Any) -> Problem:
    problem = ScenarioProblem(LoadedScenario(definition), names).rescore(score)
    problem._sizes = sizes
    return problem


def _choose_score(scenario: LoadedScenario, name: str) -> logic.Formula | str | None:
    part = scenario.definition.specifications[name]
    monitor = scenario.stack.specifications[name]
    score = part.score if isinstance(part, Formula) else monitor.score
    if isinstance(score, ScoreFormula):
        return logic.stl(score.stl, dt=scenario.stack.loop.simulator.dt, warn=False)
    if score is not None:
        return score
    if monitor.margin(monitor.start(1)) is not None:
        return "margin"
    return "progress" if isinstance(monitor, FormulaMonitor) and shape_of(monitor.formula) else None
