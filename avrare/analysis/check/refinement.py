"""Comparison of a stack with one whose simulator integrates in half the step, on the same noise tapes."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from avrare.protocols import Bools, Floats
from avrare.scenario.schema import Scenario
from avrare.stack.builder import Stack, build_stack

_MOST_TAPES, _MOST_STEPS = 8, 2000
"""Most tapes that are compared, and most steps of all of them together, except for a single one."""


@dataclass(frozen=True)
class Drives:
    """Drives of a few tapes: signals by name (steps + 1, tapes, ...), and verdicts by specification."""

    signals: dict[str, Floats]
    robustness: dict[str, Floats]
    violated: dict[str, Bools]


def compare_substeps(scenario: Scenario, stack: Stack) -> list[str]:
    """List the changes where the simulator integrates in half the step."""
    config = scenario.simulator.config
    # option by which a simulator integrates in parts of its step, while noise and all other parts keep it
    option = "substeps"
    if option not in type(config).model_fields:
        return [f"integration: the simulator has no `{option}`: whether its dt is small enough is not known"]
    substeps = dict(config)[option]
    finer = config.model_copy(update={option: 2 * substeps})
    count = max(min(_MOST_TAPES, _MOST_STEPS // (scenario.steps + 1)), 1)
    tapes = np.random.default_rng(0).standard_normal((scenario.steps + 1, count, stack.loop.noise_size))
    try:
        other = build_stack(replace(scenario, simulator=replace(scenario.simulator, config=finer)))
        now, then = (_drive(part, tapes) for part in (stack, other))
    except Exception as error:  # in a run such rollouts count as errors
        return [f"integration: not compared, as a rollout breaks down: {type(error).__name__}: {error}"]
    preferred = ("ego_x", "ego_y", "ego_speed", "others_x", "others_y", "others_speed", "gap")
    names = [name for name in preferred if name in now.signals] or list(now.signals)[:6]
    changes = [f"{name} {_greatest(now.signals[name], then.signals[name]):.2g}" for name in names]
    tried = f"{count} tape{'s' * (count > 1)}"
    lines = [
        f"integration: {option} {2 * substeps} in place of {substeps}, {tried}, greatest changes:",
        f"  {', '.join(changes)}",
    ]
    for name, robustness in now.robustness.items():
        flips = int((now.violated[name] != then.violated[name]).sum())
        change = _greatest(robustness, then.robustness[name])
        lines.append(f"  {name}: robustness {change:.2g}, {flips} of {count} verdicts")
    return lines


def _drive(stack: Stack, tapes: Floats) -> Drives:
    loop, count = stack.loop, tapes.shape[1]
    state, samples = loop.initial(tapes[0]), []
    monitors = {name: spec.start(count) for name, spec in stack.specifications.items()}
    verdicts = {}
    for step in range(len(tapes)):
        state = loop.step(state, tapes[step]) if step else state
        samples.append(loop.signals(state))
        for name, spec in stack.specifications.items():
            monitors[name], verdicts[name] = spec.update(monitors[name], samples[-1])
    signals = {name: np.stack([sample[name] for sample in samples]) for name in samples[0]}
    return Drives(
        signals,
        {name: verdict.robustness for name, verdict in verdicts.items()},
        {name: verdict.violated for name, verdict in verdicts.items()},
    )


def _greatest(coarse: Floats, fine: Floats) -> float:
    """Return the greatest difference, NaN where only one has a number; absent vehicles are left out."""
    far = 1e5  # [m]
    absent = (np.abs(coarse) >= far) | (np.abs(fine) >= far) | (np.isnan(coarse) & np.isnan(fine))
    return float(np.abs(coarse[~absent] - fine[~absent]).max(initial=0.0))
