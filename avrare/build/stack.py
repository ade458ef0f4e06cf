"""From a checked scenario to the parts that run: the only place where plugins' factories are called."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np

from avrare.build.closed_loop import ClosedLoop
from avrare.driving import Scene
from avrare.errors import AvrareError, FormulaError, PluginError, ScenarioError, UsageError
from avrare.logic.api import FormulaWarning, stl
from avrare.logic.online import FormulaMonitor
from avrare.protocols import Specification
from avrare.scenario.formulas import reach_warnings
from avrare.scenario.schema import Block, Formula, Scenario


@dataclass(frozen=True)
class Stack:
    """The built parts of a scenario.

    Attributes:
        loop: Simulator, perception, tracker and controller as one system.
        scene: What does not change, None where the simulator is no driving simulator.
        specifications: Monitor of every specification, by name.
    """

    loop: ClosedLoop
    scene: Scene | None
    specifications: dict[str, Specification]


_START_HINT = "its probability would be 1; move the vehicles, change the rule's parameters, or leave it out"


def build_stack(scenario: Scenario) -> Stack:
    """Build every part of ``scenario``.

    Raises:
        PluginError: A part needs a package that is not installed.
        UsageError: The parts do not fit each other.
    """
    _check_parts(scenario)
    with _placed(scenario, "simulator"):
        simulator = build_block(scenario.simulator, None)
    scene = getattr(simulator, "scene", None)
    parts = []
    for kind in ("perception", "tracker", "controller"):
        block = getattr(scenario, kind)
        with _placed(scenario, kind):
            parts.append(build_block(block, scene) if block is not None else None)
    specifications = {}
    for name, part in scenario.specifications.items():
        with _placed(scenario, f"specifications.{name}"):
            specifications[name] = build_specification(part, scene, simulator.dt)
    return Stack(ClosedLoop(simulator, *parts), scene, specifications)


def check_start(scenario: Scenario, stack: Stack) -> None:
    """Refuse a scenario whose noise-free start already breaks a rule: its probability is 1 by construction.

    Raises:
        ScenarioError: Naming the rules and, where they can tell, the vehicles; or what the start raised.
    """
    signals = _signals_at_start(scenario, stack)
    problems: list[tuple[str, str | None]] = []
    for name, spec in stack.specifications.items():
        with _placed(scenario, f"specifications.{name}"):
            if isinstance(scenario.specifications[name], Formula):
                _check_relations(spec, signals)
            monitor, verdict = spec.update(spec.start(1), signals)
        margin = getattr(spec, "margin", None)
        settled = margin is not None and margin(monitor) is not None
        if settled and verdict.violated[0]:
            explain = getattr(spec, "explain", None)
            culprit = f": {explain(signals)}" if explain is not None else ""
            place = f"{scenario.path}: specifications.{name}"
            problems.append((f"{place}: violated at sample 0 by the noise-free start{culprit}", _START_HINT))
    if problems:
        raise ScenarioError(problems)


def _signals_at_start(scenario: Scenario, stack: Stack) -> Mapping[str, Any]:
    try:
        return stack.loop.signals(stack.loop.initial(np.zeros((1, stack.loop.noise_size))))
    except AvrareError:
        raise
    except Exception as error:  # a plugin's, not ours
        reason = f"{type(error).__name__}: {' '.join(str(error).split())}"
        place = f"{scenario.path}: the noise-free start raised {reason}"
        raise ScenarioError([(place, "see what its parts make of their options")]) from error


def _check_relations(spec: Specification, signals: Mapping[str, Any]) -> None:
    """Refuse predicates of vehicles in a plain formula, whose signals are the simulator's.

    Raises:
        FormulaError: Saying what knows them.
    """
    formula = getattr(spec, "formula", None)
    for name in [] if formula is None else formula.signals:
        if name not in signals and name.endswith(")"):
            hint = "predicates of vehicles are a plugin's: write {plugin: traffic_rules, formula: ...}"
            raise FormulaError(f"signal {name!r} is missing", f"{hint} in place of {{stl: ...}}")


def build_and_try(scenario: Scenario, steps: int = 3) -> list[tuple[str, str | None]]:
    """Build the stack and run a few noise-free steps: what ``validate --build`` does.

    Returns:
        Warnings (message, hint) on plugins' specifications: those that loading the scenario cannot tell.
    """
    stack = build_stack(scenario)
    check_start(scenario, stack)
    noise = np.zeros((1, stack.loop.noise_size))
    state = stack.loop.initial(noise)
    monitors = {name: spec.start(1) for name, spec in stack.specifications.items()}
    for step in range(min(steps, scenario.steps) + 1):
        state = stack.loop.step(state, noise) if step else state
        signals = stack.loop.signals(state)
        for name, spec in stack.specifications.items():
            monitors[name], _ = spec.update(monitors[name], signals)
    return [doubt for name, spec in stack.specifications.items() for doubt in _doubts(scenario, name, spec)]


def _doubts(scenario: Scenario, name: str, spec: Specification) -> list[tuple[str, str | None]]:
    """What looks odd in the formula of a plugin; of a plain one loading has said it all."""
    part, formula = scenario.specifications[name], getattr(spec, "formula", None)
    if formula is None or not isinstance(part, Block):
        return []
    found = [] if part.component.check else [(one.message, one.hint) for one in formula.warnings]
    found += [(text, None) for text in reach_warnings(formula.node, scenario.steps)]
    return [(f"{scenario.path}: specifications.{name}: {text}", hint) for text, hint in found]


@contextmanager
def _placed(scenario: Scenario, path: str) -> Iterator[None]:
    """Errors of a part say where in the scenario the part is."""
    try:
        yield
    except UsageError as error:
        raise ScenarioError([(f"{scenario.path}: {path}: {error.message}", error.hint)]) from error


def _check_parts(scenario: Scenario) -> None:
    if scenario.perception is not None and scenario.tracker is None:
        raise UsageError(
            f"{scenario.path}: perception: there is no tracker to hand the observations to",
            "add a `tracker:` block, or leave the perception out",
        )


def build_block(block: Block, scene: Scene | None) -> Any:
    """What a block describes.

    Raises:
        PluginError: Its implementation cannot be imported.
        UsageError: It drives on a road, and there is none.
    """
    if block.component.driving and scene is None:
        raise UsageError(
            f"{block.component.kind} {block.plugin!r} is for vehicles on a road, and this simulator has none",
            "take a driving simulator, such as single_track, or leave this part out",
        )
    try:
        factory = block.component.load_factory()
    except ImportError as error:
        package = block.distribution or block.component.name
        raise PluginError(
            f"{block.component.kind} {block.plugin!r} cannot be loaded: {error}",
            f"pip install --upgrade {package}",
        ) from error
    with warnings.catch_warnings():  # a formula's doubts are told where it is written
        warnings.simplefilter("ignore", FormulaWarning)
        return factory(block.config, scene)


def build_specification(part: Block | Formula, scene: Scene | None, dt: float) -> Specification:
    """The monitor of one specification, for signals every ``dt`` [s]."""
    if isinstance(part, Block):
        return build_block(part, scene)  # type: ignore[no-any-return]
    return FormulaMonitor(stl(part.stl, dt=dt, until=part.until, warn=False))
