"""Builder of the stack: turns a validated scenario into parts by calling the plugins' factories."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from avrare.base import batch
from avrare.base.errors import AvrareError, FormulaError, PluginError, ScenarioError, UsageError, find_place
from avrare.driving import Observation, Scene
from avrare.logic.formula import FormulaMonitor, FormulaWarning, stl
from avrare.plugin.registry import Row, default_registry
from avrare.plugin.rule_catalogue import Catalogue
from avrare.protocols import (
    BASES,
    Controller,
    Floats,
    PerceptionErrorModel,
    Signals,
    Simulator,
    Specification,
    Tracker,
    adapt,
    list_missing_members,
    overrides,
)
from avrare.scenario.overrides import override
from avrare.scenario.schema import Block, Formula, Scenario
from avrare.scenario.specification_checks import reach_warnings
from avrare.scenario.timing import Actuators, Timing
from avrare.scenario.validation import check, scenario_error
from avrare.scenario.value_positions import Mark, Node
from avrare.stack.array_checks import check_signals
from avrare.stack.clock import Clock
from avrare.stack.closed_loop import ClosedLoop, LoopState
from avrare.stack.drawn_start import DrawnStart
from avrare.stack.emergency_braking import add_emergency_braking
from avrare.stack.misfits import explain_misfits
from avrare.stack.noise_names import check_declarations, check_dynamics
from avrare.stack.timed_parts import Parts, time_parts
from avrare.stack.unlabelled import check_labels

PartT = TypeVar("PartT")

_STARTS = 32
"""Starts drawn with noise where the noise-free one violates a specification."""


@dataclass(frozen=True)
class Stack:
    """Built parts of a scenario.

    Attributes:
        loop: Simulator, perception, tracker and controller as one system.
        scene: Road, sizes and names of a driving simulator, else None.
        specifications: Monitor of every specification, by name.
    """

    loop: ClosedLoop
    scene: Scene | None
    specifications: dict[str, Specification]


def build_stack(scenario: Scenario) -> Stack:
    """Build every part of ``scenario``; they must fit together."""
    if scenario.perception is not None and scenario.tracker is None:
        raise UsageError(
            f"{scenario.path}: perception: no tracker is given to process the observations",
            "add a `tracker:` block, or remove the perception",
        )
    with _locate_errors(scenario, "simulator"):
        simulator = _build_simulator(scenario.simulator)
        check_dynamics(simulator)
    with _locate_errors(scenario, "steps"):
        simulator.check_steps(scenario.steps)
    scene = simulator.scene
    with _locate_errors(scenario, "timing"):
        clock = Clock.of(scenario.timing or Timing(), simulator.dt)
    plane = scene or simulator.junction
    parts = _build_parts(scenario, plane, clock)
    specifications = {}
    for name, part in scenario.specifications.items():
        with _locate_errors(scenario, f"specifications.{name}"):
            specifications[name] = build_specification(part, plane, simulator.dt)
    draws = scenario.simulator.draws
    start = DrawnStart(draws, simulator, specifications) if draws is not None else None
    return Stack(ClosedLoop(simulator, *parts, start), scene, specifications)


def _build_parts(scenario: Scenario, scene: Scene | None, clock: Clock) -> Parts:
    perception, tracker, controller, seen_scene = None, None, None, scene
    if scenario.perception is not None:
        with _locate_errors(scenario, "perception"):
            perception = build_block(
                scenario.perception, clock.pace_scene(scene, clock.sensor), PerceptionErrorModel
            )
            check_declarations(perception)
    if scenario.tracker is not None:
        with _locate_errors(scenario, "tracker"):
            tracker = build_block(scenario.tracker, clock.pace_scene(scene, clock.tracker), Tracker)
            if perception is not None:
                check_labels(perception, tracker)
            seen_scene = tracker.known_scene or scene
    if scenario.controller is not None:
        with _locate_errors(scenario, "controller"):
            paced = clock.pace_scene(seen_scene, clock.planner)
            controller = build_block(scenario.controller, paced, Controller)
    if scenario.aeb is not None:
        with _locate_errors(scenario, "aeb"):
            controller = add_emergency_braking(
                controller, scenario.aeb, clock.pace_scene(seen_scene, clock.planner)
            )
    if controller is not None and adapt(Controller, controller).sees_truth:
        perception, tracker = None, None  # nobody reads them
    timing, actuators = scenario.timing or Timing(), scenario.actuators or Actuators()
    with _locate_errors(scenario, "timing"):
        return time_parts(timing, actuators, clock, scene, Parts(perception, tracker, controller))


def _build_simulator(block: Block) -> Simulator:
    simulator = build_block(block, None, Simulator)
    if block.draws is None:
        return simulator
    if not all(overrides(simulator, default) for default in (Simulator.drawing, Simulator.reset_drawn)):
        raise PluginError(
            f"simulator {block.plugin!r} marks options as drawable, but has no `drawing` and `reset_drawn`",
            "see avrare.protocols.Simulator",
        )
    return adapt(Simulator, simulator.drawing(dict(zip(block.draws.paths, block.draws.laws, strict=True))))


def refuse_violated_starts(scenario: Scenario, stack: Stack) -> None:
    """Raise a ``ScenarioError`` for specifications that every start violates: their probability is 1."""
    for name, spec in stack.specifications.items():
        if isinstance(scenario.specifications[name], Formula):
            with _locate_errors(scenario, f"specifications.{name}"):
                _check_relations(spec)
    signals = _signals_at_start(scenario, stack, np.zeros((1, stack.loop.noise_size)))
    problems: list[tuple[str, str | None]] = []
    for name, spec in stack.specifications.items():
        with _locate_errors(scenario, f"specifications.{name}"):
            monitor, verdict = spec.update(spec.start(1), signals)
        settled = spec.margin(monitor) is not None
        if settled and verdict.violated[0] and _fails_from_drawn_starts(scenario, stack, spec):
            cause = spec.explain(signals)
            culprit = f": {cause}" if cause else ""
            place = f"{scenario.path}: specifications.{name}"
            hint = "move the vehicles, change the parameters of the specification, or remove it"
            text = f"{place}: violated at sample 0 by the noise-free start, and by all others tried{culprit}"
            problems.append((text, f"its probability would be 1, or nearly; {hint}"))
    if problems:
        raise ScenarioError(problems)


def _fails_from_drawn_starts(scenario: Scenario, stack: Stack, spec: Specification) -> bool:
    """Return whether a few starts that are drawn with noise all violate a specification."""
    noise = np.random.default_rng(0).standard_normal((_STARTS, stack.loop.noise_size))
    signals = _signals_at_start(scenario, stack, noise)
    return bool(spec.update(spec.start(_STARTS), signals)[1].violated.all())


def _signals_at_start(scenario: Scenario, stack: Stack, noise: Floats) -> Signals:
    try:
        return check_signals(stack.loop.signals(stack.loop.initial(noise)), len(noise))
    except AvrareError:
        raise
    except Exception as error:  # raised by a plugin
        reason = f"{type(error).__name__}: {' '.join(str(error).split())}"
        which = "a start" if noise.any() else "the noise-free start"
        place = f"{scenario.path}: {which} raised {reason}"
        raise ScenarioError([(place, "check the options of its parts")]) from error


def _check_relations(spec: Specification) -> None:
    for name in [] if spec.formula is None else spec.formula.signals:
        if name.endswith(")"):
            hint = "predicates of vehicles belong to a plugin: write {plugin: traffic_rules, formula: ...}"
            raise FormulaError(f"signal {name!r} is missing", f"{hint} instead of {{stl: ...}}")


def try_stack(scenario: Scenario, stack: Stack, steps: int = 3) -> list[tuple[str, str | None]]:
    """Run a few noise-free steps and return warnings (message, hint) on the specifications.

    Only those of plugins: loading the scenario has warned of the others.

    Raises:
        PluginError: A signal is NaN.
    """
    noise = np.zeros((1, stack.loop.noise_size))
    states = [stack.loop.initial(noise)]
    monitors = {name: spec.start(1) for name, spec in stack.specifications.items()}
    for step in range(min(steps, scenario.steps) + 1):
        if step:
            with explain_misfits(scenario.path, stack.loop, states[-1]):
                states.append(stack.loop.step(states[-1], noise))
        signals = stack.loop.signals(states[-1])
        if unknown := [name for name, values in signals.items() if _has_nan(values)]:
            names = ", ".join(unknown[:3]) + (f" and {len(unknown) - 3} more" if len(unknown) > 3 else "")
            part, sample = _find_nan(stack.loop, states) or (f"simulator: its signals ({names}) are", step)
            text = f"{scenario.path}: {part} NaN at sample {sample} of a noise-free rollout"
            raise PluginError(text, f"rollouts with NaN in a signal ({names}) are errors: mend this part")
        for name, spec in stack.specifications.items():
            monitors[name], _ = spec.update(monitors[name], signals)
    return [warning for name, spec in stack.specifications.items() for warning in _lint(scenario, name, spec)]


def _has_nan(part: object) -> bool:
    leaves: list[NDArray[np.generic]] = []
    with suppress(UsageError):  # no batch: a controller may give whatever its simulator takes
        plain = isinstance(part, (float, np.generic, np.ndarray))
        leaves = [np.asarray(part)] if plain else batch.leaves(part)
    return any(leaf.dtype.kind == "f" and bool(np.isnan(leaf).any()) for leaf in leaves)


def _reports_nan(seen: Observation | None) -> bool:
    return seen is not None and any(
        bool(np.isnan(values[seen.detected]).any()) for values in (seen.x, seen.y, seen.speed_x)
    )


def _find_nan(loop: ClosedLoop, states: Sequence[LoopState]) -> tuple[str, int] | None:
    """Find the first part with a NaN before the last state, and its step; None: the simulator."""
    for sample, state in enumerate(states[:-1]):
        if loop.controller is not None and _has_nan(loop.show(state.world)):
            return None
        if _reports_nan(state.observation):
            return "perception: its observation is", sample
        if _has_nan(loop.predict(state)):
            return "tracker: its prediction is", sample
        if _has_nan(loop.act(state)[0]):
            return "controller: its action is", sample
    return None


def try_draws(scenario: Scenario, stack: Stack, scenes: int = 50, steps: int = 3) -> list[str]:
    """Draw scenes, run each for a few steps and return notes; none where nothing is drawn.

    Raises:
        ScenarioError: A scene cannot be drawn or driven.
    """
    start, loop = stack.loop.start, stack.loop
    if start is None:
        return []
    noise = np.random.default_rng(0).standard_normal((steps + 1, scenes, loop.noise_size))
    with _locate_errors(scenario, "simulator"):
        state = loop.initial(noise[0])
        drawn = state.drawn
        for row in noise[1 : scenario.steps + 1]:
            state = loop.step(state, row)
    broken = int(loop.faults(state).sum())
    if broken == scenes:
        text = f"{scenario.path}: simulator: each of {scenes} drawn scenes is impossible or breaks down"
        raise ScenarioError([(text, "bring the laws nearer to a scene that can be driven")])
    again = 0 if drawn is None else int((drawn.redraws > 0).sum())
    count = f"{start.size} option{'s' * (start.size != 1)} drawn"
    return [f"{count}, {scenes} scenes tried: {again} of them drawn again, {broken} in error"]


def _lint(scenario: Scenario, name: str, spec: Specification) -> list[tuple[str, str | None]]:
    part, formula = scenario.specifications[name], spec.formula
    if formula is None or not isinstance(part, Block):
        return []
    findings = (
        [] if part.component.check else [(warning.message, warning.hint) for warning in formula.warnings]
    )
    findings += [(text, None) for text in reach_warnings(formula.node, scenario.steps)]
    return [(f"{scenario.path}: specifications.{name}: {text}", hint) for text, hint in findings]


@contextmanager
def _locate_errors(scenario: Scenario, path: str) -> Iterator[None]:
    try:
        yield
    except UsageError as error:
        raise ScenarioError([(f"{scenario.path}: {path}: {error.message}", error.hint)]) from error


def build_block(block: Block, scene: Scene | None, contract: type[PartT]) -> PartT:
    """Build the part that a block describes, an instance of its ``contract``.

    ``scene`` is the simulator's, None if it has no road; a controller for vehicles needs one with lanes.
    """
    has_lanes = scene is not None and bool(scene.road.lane_centres)
    if block.component.driving and not (has_lanes if contract is Controller else scene):
        needed = "a road with lanes" if contract is Controller else "a road"
        raise UsageError(
            f"{block.component.kind} {block.plugin!r} is for vehicles on {needed}; this simulator has none",
            "choose a driving simulator, such as single_track, or remove this part",
        )
    with _plugin_errors(block, "loaded"):
        factory = block.component.load_factory()
    with _plugin_errors(block, "built"), warnings.catch_warnings():
        warnings.simplefilter("ignore", FormulaWarning)  # given where the formula is validated
        part = factory(block.config, scene)
    kind = block.component.kind
    if missing := list_missing_members(BASES[kind], part):
        text = f"{kind} {block.plugin!r} is not complete: {type(part).__name__} has no {', '.join(missing)}"
        raise PluginError(text, f"see what a {kind} needs: avrare plugins --check {block.plugin}")
    built: PartT = adapt(BASES[kind], part)  # a contract may be a generic alias, which has no members
    return built


@contextmanager
def _plugin_errors(block: Block, done: str) -> Iterator[None]:
    """Turn an exception of a plugin that is loaded or built into a ``PluginError`` that names the place."""
    try:
        yield
    except (AvrareError, MemoryError):
        raise
    except (Exception, SystemExit) as error:
        package = block.distribution or block.component.name
        reason = f"{type(error).__name__}: {' '.join(str(error).split())} ({find_place(error)})"
        hint = f"mend it, then: avrare plugins --check {block.plugin}"
        if isinstance(error, ImportError):
            reason, hint = str(error), f"pip install --upgrade {package}"
            if isinstance(error, ModuleNotFoundError) and error.name and "." not in error.name:
                hint = f"pip install the package of the module {error.name!r}, or --upgrade {package}"
        text = f"{block.component.kind} {block.plugin!r} of {package} cannot be {done}: {reason}"
        raise PluginError(text, hint) from error


def build_specification(part: Block | Formula, scene: Scene | None, dt: float) -> Specification:
    """Build the monitor of one specification, for signals every ``dt`` [s]."""
    if isinstance(part, Block):
        return build_block(part, scene, Specification)
    return FormulaMonitor(stl(part.stl, dt=dt, until=part.until, warn=False))


def build_rule(name: str, settings: Sequence[str], scene: Scene) -> Specification:
    """Build the monitor of a plugin's rule, with ``KEY=VALUE`` options of the plugin as for ``--set``."""
    offers = Catalogue.of(default_registry()).find(name)
    if len(offers) > 1:
        both = " and ".join(offer.row.name for offer in offers)
        raise UsageError(
            f"rule {name!r} is offered by more than one plugin: {both}",
            "put it in a scenario, and name its specification",
        )
    return _build_configured(offers[0].row, "rule", name, settings, scene)


def build_formula(text: str, settings: Sequence[str], scene: Scene) -> Specification:
    """Build the monitor of a formula over vehicles, whose predicates a plugin defines.

    Args:
        text: Formula such as ``forall o in others: always (time_to_collision(ego, o) > 1.5)``.
        settings: ``KEY=VALUE`` options of the plugin, as for ``--set``.
        scene: Road, sizes and names.
    """
    for row in dict.fromkeys(offer.row for offer in Catalogue.of(default_registry()).offers):
        if row.component is not None and "formula" in row.component.load_config().model_fields:
            return _build_configured(row, "formula", text, settings, scene)
    raise PluginError(
        "no installed plugin defines predicates of vehicles", "pip install avrare-traffic-rules"
    )


def _build_configured(row: Row, key: str, value: str, settings: Sequence[str], scene: Scene) -> Specification:
    component = default_registry().require("specification", row.name)
    mark = Mark("--rule" if key == "rule" else "--stl")
    node = override(Node({key: Node(value, mark, mark)}, mark), settings)
    config, problems = check(component.load_config(), node)
    if config is None:
        raise scenario_error(problems)
    block = Block(row.name, component, config, row.distribution, row.version)
    return build_block(block, scene, Specification)
