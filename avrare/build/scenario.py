"""A loaded scenario with its stack: builds problems for Python callers, the command line and the workers."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any

from avrare.build.stack import Stack, build_stack, check_start
from avrare.driving import Scene
from avrare.errors import UsageError, did_you_mean
from avrare.estimation.plan import Estimator
from avrare.logic import api as logic
from avrare.logic.online import FormulaMonitor
from avrare.rollout.problem import Problem
from avrare.rollout.progress import shape_of
from avrare.scenario.schema import Formula, Scenario, ScoreFormula


class BuildableScenario:
    """What ``avrare.load`` returns.

    Attributes:
        definition: The checked scenario.
    """

    def __init__(self, definition: Scenario) -> None:
        self.definition = definition

    @property
    def name(self) -> str:
        """Name of the scenario."""
        return self.definition.name

    @property
    def steps(self) -> int:
        """Steps of a rollout."""
        return self.definition.steps

    @property
    def specifications(self) -> tuple[str, ...]:
        """Names of the specifications."""
        return tuple(self.definition.specifications)

    @cached_property
    def stack(self) -> Stack:
        """The built parts; checked once that the start breaks no rule."""
        stack = build_stack(self.definition)
        check_start(self.definition, stack)
        return stack

    @property
    def scene(self) -> Scene | None:
        """Road, sizes and names, if the simulator is a driving simulator."""
        return self.stack.scene

    def problem(self, specification: str | Sequence[str]) -> Problem:
        """The problem of one specification, or of several that are scored in one pass.

        Raises:
            UsageError: There is no such specification.
        """
        names = (specification,) if isinstance(specification, str) else tuple(specification)
        for name in names:
            if name not in self.definition.specifications:
                raise UsageError(
                    f"scenario {self.name!r} has no specification {name!r}",
                    did_you_mean(name, self.definition.specifications),
                )
        return ScenarioProblem(self, names)

    def estimator(self) -> Estimator:
        """The scenario's estimator."""
        block = self.definition.estimator
        return block.component.load_factory()(block.config, self.scene)  # type: ignore[no-any-return]


class ScenarioProblem(Problem):
    """A problem that travels to a worker as its scenario and is built anew there."""

    def __init__(self, scenario: BuildableScenario, names: tuple[str, ...]) -> None:
        self.scenario = scenario
        stack, definition = scenario.stack, scenario.definition
        specifications = {name: stack.specifications[name] for name in names}
        super().__init__(
            stack.loop, specifications, definition.steps, _score(scenario, names[0]), chunk=definition.chunk
        )

    def __reduce__(self) -> tuple[Any, ...]:
        return _rebuild, (self.scenario.definition, self.names, self.score)


def _rebuild(definition: Scenario, names: tuple[str, ...], score: Any) -> Problem:
    return ScenarioProblem(BuildableScenario(definition), names).rescored(score)


def _score(scenario: BuildableScenario, name: str) -> logic.Formula | str | None:
    """The score that orders particles: as written, else by the formula's shape (ADR 3)."""
    part = scenario.definition.specifications[name]
    monitor = scenario.stack.specifications[name]
    own = part.score if isinstance(part, Formula) else getattr(part.config, "score", None)
    if isinstance(own, ScoreFormula):
        return logic.stl(own.stl, dt=scenario.stack.loop.simulator.dt, warn=False)
    if own is not None:
        return own
    margin = getattr(monitor, "margin", None)
    if margin is not None and margin(monitor.start(1)) is not None:
        return "margin"
    return "progress" if isinstance(monitor, FormulaMonitor) and shape_of(monitor.formula) else None
