"""Builder of the stack: turns a validated scenario into parts by calling the plugins' factories."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import NamedTuple, TypeVar

from avrare.base.errors import AvrareError, PluginError, ScenarioError, UsageError, find_place
from avrare.driving import Scene
from avrare.logic.formula import FormulaMonitor, FormulaWarning, stl
from avrare.plugin.registry import Row, default_registry
from avrare.plugin.rule_catalogue import Catalogue
from avrare.protocols import (
    BASES,
    Controller,
    PerceptionErrorModel,
    Simulator,
    Specification,
    Tracker,
    adapt,
    list_missing_members,
    overrides,
)
from avrare.scenario.overrides import override
from avrare.scenario.schema import Block, Formula, Scenario
from avrare.scenario.timing import Actuators, Timing
from avrare.scenario.validation import check, scenario_error
from avrare.scenario.value_positions import Mark, Node
from avrare.stack.clock import Clock
from avrare.stack.closed_loop import ClosedLoop
from avrare.stack.drawn_start import DrawnStart
from avrare.stack.emergency_braking import add_emergency_braking
from avrare.stack.observation import check_labels
from avrare.stack.part_checks import check_declarations, check_dynamics
from avrare.stack.timed_controller import TimedController
from avrare.stack.timed_perception import ExactPerception, PacedTracker, TimedPerception

PartT = TypeVar("PartT")


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


class Parts(NamedTuple):
    """Parts of a stack, as far as there are any."""

    perception: PerceptionErrorModel | None
    tracker: Tracker | None
    controller: Controller | None


def build_stack(scenario: Scenario) -> Stack:
    """Build every part of ``scenario``; they must fit together."""
    if scenario.perception is not None and scenario.tracker is None:
        raise UsageError(
            f"{scenario.path}: perception: no tracker is given to process the observations",
            "add a `tracker:` block, or remove the perception",
        )
    with locate_errors(scenario, "simulator"):
        simulator = _build_simulator(scenario.simulator)
        check_dynamics(simulator)
    with locate_errors(scenario, "steps"):
        simulator.check_steps(scenario.steps)
    scene = simulator.scene
    with locate_errors(scenario, "timing"):
        clock = Clock.of(scenario.timing or Timing(), simulator.dt)
    plane = scene or simulator.junction
    parts = _build_parts(scenario, plane, clock)
    specifications = {}
    for name, part in scenario.specifications.items():
        with locate_errors(scenario, f"specifications.{name}"):
            specifications[name] = build_specification(part, plane, simulator.dt)
    draws = scenario.simulator.draws
    start = DrawnStart(draws, simulator, specifications) if draws is not None else None
    return Stack(ClosedLoop(simulator, *parts, start), scene, specifications)


def _build_parts(scenario: Scenario, scene: Scene | None, clock: Clock) -> Parts:
    perception, tracker, controller, seen_scene = None, None, None, scene
    if scenario.perception is not None:
        with locate_errors(scenario, "perception"):
            perception = build_block(
                scenario.perception, clock.pace_scene(scene, clock.sensor), PerceptionErrorModel
            )
            check_declarations(perception)
    if scenario.tracker is not None:
        with locate_errors(scenario, "tracker"):
            tracker = build_block(scenario.tracker, clock.pace_scene(scene, clock.tracker), Tracker)
            if perception is not None:
                check_labels(perception, tracker)
            seen_scene = tracker.known_scene or scene
    if scenario.controller is not None:
        with locate_errors(scenario, "controller"):
            paced = clock.pace_scene(seen_scene, clock.planner)
            controller = build_block(scenario.controller, paced, Controller)
    if scenario.aeb is not None:
        with locate_errors(scenario, "aeb"):
            controller = add_emergency_braking(
                controller, scenario.aeb, clock.pace_scene(seen_scene, clock.planner)
            )
    if controller is not None and adapt(Controller, controller).sees_truth:
        perception, tracker = None, None  # nobody reads them
    timing, actuators = scenario.timing or Timing(), scenario.actuators or Actuators()
    with locate_errors(scenario, "timing"):
        return time_parts(timing, actuators, clock, scene, Parts(perception, tracker, controller))


def time_parts(
    timing: Timing, actuators: Actuators, clock: Clock, scene: Scene | None, parts: Parts
) -> Parts:
    """Return the parts with the delays that ``timing`` and ``actuators`` ask for.

    Raises:
        UsageError: An option belongs to a part that the scenario lacks.
    """
    of_frames = ("sensor_period", "tracker_period", "perception_latency", "perception_jitter", "lost_frames")
    of_cycles = ("planner_period", "planning_latency", "missed_cycles", "actuation_delay", "compensated")
    frames, cycles = ([name for name in names if getattr(timing, name)] for names in (of_frames, of_cycles))
    if frames and parts.tracker is None:
        raise UsageError(f"{frames[0]} needs a tracker", "add a `tracker:` block, or remove the option")
    controlled = bool(cycles) or actuators != Actuators()
    if controlled and parts.controller is None:
        name = cycles[0] if cycles else "actuators"
        raise UsageError(f"{name}: needs a controller", "add a `controller:` block, or remove the option")
    perception, tracker, controller = parts
    if frames:
        perception = TimedPerception(perception or ExactPerception(), timing, clock)
    if tracker is not None and (clock.tracker, clock.planner) != (1, 1):
        tracker = PacedTracker(tracker, clock)
    if controlled and controller is not None:
        controller = TimedController(controller, timing, clock, actuators, scene)
    return Parts(perception, tracker, controller)


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


@contextmanager
def locate_errors(scenario: Scenario, path: str) -> Iterator[None]:
    """Turn a ``UsageError`` into a ``ScenarioError`` that names the place in the scenario."""
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
            "put the rule of one of them under `specifications` of a scenario, and name that specification",
        )
    return _build_from_settings(offers[0].row, "rule", name, settings, scene)


def build_formula(text: str, settings: Sequence[str], scene: Scene) -> Specification:
    """Build the monitor of a formula over vehicles, whose predicates a plugin defines.

    Args:
        text: Formula such as ``forall o in others: always (time_to_collision(ego, o) > 1.5)``.
        settings: ``KEY=VALUE`` options of the plugin, as for ``--set``.
        scene: Road, sizes and names.
    """
    for row in dict.fromkeys(offer.row for offer in Catalogue.of(default_registry()).offers):
        if row.component is not None and "formula" in row.component.load_config().model_fields:
            return _build_from_settings(row, "formula", text, settings, scene)
    raise PluginError(
        "no installed plugin defines predicates of vehicles", "pip install avrare-traffic-rules"
    )


def _build_from_settings(
    row: Row, key: str, value: str, settings: Sequence[str], scene: Scene
) -> Specification:
    component = default_registry().require("specification", row.name)
    mark = Mark("--rule" if key == "rule" else "--stl")
    node = override(Node({key: Node(value, mark, mark)}, mark), settings)
    config, problems = check(component.load_config(), node)
    if config is None:
        raise scenario_error(problems)
    block = Block(row.name, component, config, row.distribution, row.version)
    return build_block(block, scene, Specification)
