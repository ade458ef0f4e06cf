"""First rollouts of a built stack: starts, a few steps and drawn scenes, with what goes wrong in them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress

import numpy as np
from numpy.typing import NDArray

from avrare.base import batch
from avrare.base.errors import AvrareError, FormulaError, PluginError, ScenarioError, UsageError, find_place
from avrare.driving import Observation
from avrare.protocols import (
    Floats,
    Signals,
    Specification,
)
from avrare.scenario.schema import Block, Formula, Scenario
from avrare.scenario.specification_checks import reach_warnings
from avrare.stack.builder import Stack, locate_errors
from avrare.stack.closed_loop import ClosedLoop, LoopState
from avrare.stack.part_checks import check_signals


def refuse_violated_starts(scenario: Scenario, stack: Stack) -> None:
    """Raise a ``ScenarioError`` for specifications that every start violates: their probability is 1."""
    for name, spec in stack.specifications.items():
        if isinstance(scenario.specifications[name], Formula):
            with locate_errors(scenario, f"specifications.{name}"):
                _check_relations(spec)
    signals = _signals_at_start(scenario, stack, np.zeros((1, stack.loop.noise_size)))
    problems: list[tuple[str, str | None]] = []
    for name, spec in stack.specifications.items():
        with locate_errors(scenario, f"specifications.{name}"):
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
    starts = 32  # starts drawn with noise where the noise-free one violates a specification
    noise = np.random.default_rng(0).standard_normal((starts, stack.loop.noise_size))
    signals = _signals_at_start(scenario, stack, noise)
    return bool(spec.update(spec.start(starts), signals)[1].violated.all())


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
            with _explain_misfits(scenario.path, stack.loop, states[-1]):
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
    """Draw scenes, run each for a few steps and return notes; empty for scenes without random options.

    Raises:
        ScenarioError: A scene cannot be drawn or driven.
    """
    start, loop = stack.loop.start, stack.loop
    if start is None:
        return []
    noise = np.random.default_rng(0).standard_normal((steps + 1, scenes, loop.noise_size))
    with locate_errors(scenario, "simulator"):
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
def _explain_misfits(path: str, loop: ClosedLoop, state: LoopState) -> Iterator[None]:
    """Turn an exception of a step from ``state`` into a ``PluginError`` that names the part and its input."""
    try:
        yield
    except (AvrareError, MemoryError):
        raise
    except (Exception, SystemExit) as error:
        part, hint = _find_part(loop, state)
        text = f"{path}: the {part} breaks down in its first steps: {type(error).__name__}: {error}"
        raise PluginError(f"{text} ({find_place(error)})", hint) from error


def _find_part(loop: ClosedLoop, state: LoopState) -> tuple[str, str]:
    if loop.controller is None:
        return "stack", "its simulator gets the action None: if it needs another, add a `controller:`"
    try:
        action, _ = loop.act(state)
    except (Exception, SystemExit):
        view = _describe(loop.show(state.world))
        if not hasattr(state.world, "ego"):
            names = ", ".join(loop.simulator.signals(state.world))
            view += f", the signals {names}: give the simulator's state an attribute `ego` to show it another"
        return "controller", f"it sees {view}"
    return "stack", f"its simulator gets the controller's action, {_describe(action)}"


def _describe(value: object) -> str:
    if isinstance(value, np.ndarray):
        return f"an array {value.shape} for N = {len(value)}" if value.ndim else "an array without rows"
    members = ", ".join(vars(value)) if hasattr(value, "__dict__") else ""
    return f"a {type(value).__name__}" + (f" with {members}" if members else "")
