"""Replay of a stored failure, and what differs from when it was stored."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from avrare.analysis.failures.failure import Failure, compute_checksums, compute_fingerprints, round_values
from avrare.base.errors import UsageError
from avrare.protocols import Floats
from avrare.rollout.loaded_scenario import LoadedScenario
from avrare.rollout.replay import ReplayedRollout, replay_tape, tabulate_signals

_MAX_NAMED = 3
"""Number of differing signals that are named; the others are counted."""


@dataclass(frozen=True)
class FailureReplay:
    """Replay of a stored failure.

    Attributes:
        failure: Failure as it was stored.
        rollout: Rollout now.
        changes: Messages about parts of the scenario and versions that have changed.
        divergence: First difference from the stored signals (or, without them, from the stored robustness);
            None if they are bit-identical.
    """

    failure: Failure
    rollout: ReplayedRollout
    changes: tuple[str, ...]
    divergence: str | None


def replay_failure(scenario: LoadedScenario, failure: Failure) -> FailureReplay:
    """Replay a stored failure on its scenario, or on a changed one.

    Raises:
        UsageError: The scenario has no such specification, or needs noise of another shape.
    """
    problem = scenario.problem(failure.specification)
    changes = _find_changes(scenario, failure)
    expected = (problem.steps + 1, problem.noise_size)
    if failure.noise.shape != expected:
        stored, needed = (" x ".join(map(str, shape)) for shape in (failure.noise.shape, expected))
        text = f"failure {failure.id} has {stored} numbers of noise, but {scenario.name} needs {needed}"
        raise UsageError(text, "; ".join(changes) or None)
    rollout = replay_tape(problem, failure.noise)
    return FailureReplay(failure, rollout, changes, _find_divergence(failure, rollout, scenario))


def _find_changes(scenario: LoadedScenario, failure: Failure) -> tuple[str, ...]:
    now = compute_fingerprints(scenario.definition, failure.specification)
    versions = scenario.definition.versions
    changes = []
    if failure.scenario != scenario.name:
        changes.append(f"name of the scenario: {failure.scenario} -> {scenario.name}")
    for name, value in now.items():
        if failure.parts.get(name) != value:
            changes.append(f"{name} differs: fingerprint {failure.parts.get(name, 'none')} -> {value}")
    # If all parts are the same, a plugin present only once belongs to an estimator, which does not matter.
    names = {*failure.versions, *versions} if changes else {*failure.versions} & {*versions}
    for name in sorted(names):
        before, after = failure.versions.get(name), versions.get(name)
        if before != after:
            changes.append(f"{name} {before or 'none'} -> {after or 'none'}")
    return tuple(changes)


def _find_divergence(failure: Failure, rollout: ReplayedRollout, scenario: LoadedScenario) -> str | None:
    if not len(failure.checksums):
        then, now = failure.robustness, rollout.robustness
        return None if now == then else f"robustness differs: {_format_change(then, now)}"
    columns, values = tabulate_signals(rollout.signals, scenario.scene)
    if rollout.signals and columns != failure.columns:
        missing = [f"no {name}" for name in failure.columns if name not in columns]
        new = [name for name in columns if name not in failure.columns]
        return f"the scenario has different signals: {', '.join(missing[:_MAX_NAMED] + new[:_MAX_NAMED])}"
    sums = compute_checksums(rollout.signals)
    differs = np.flatnonzero(sums != failure.checksums[: len(sums)])
    if len(differs):
        first = int(differs[0])
        return f"the signals differ from step {first} on{_describe_changes(failure, values, first)}"
    if len(sums) < len(failure.checksums):
        return f"the rollout ends with an error at step {len(sums)}, which it did not before"
    return None


def _describe_changes(failure: Failure, values: Floats, first: int) -> str:
    if not len(failure.values):
        return ""
    now = round_values(values)
    then = failure.values[: len(now)]
    changed = (then != now) & ~(np.isnan(then) & np.isnan(now))
    visible = np.flatnonzero(changed.any(axis=1))
    if not len(visible):
        return ", by less than a part in 4000"
    step = int(visible[0])
    columns = np.flatnonzero(changed[step])
    named = [
        f"{failure.columns[k]} {_format_change(float(then[step, k]), float(now[step, k]))}"
        for k in columns[:_MAX_NAMED]
    ]
    rest = f" and {len(columns) - _MAX_NAMED} more" if len(columns) > _MAX_NAMED else ""
    late = f", visibly from step {step} on" if step > first else ""
    return f"{late}: {', '.join(named)}{rest}"


def _format_change(then: float, now: float) -> str:
    # as many digits as it takes to tell them apart
    texts = [(f"{then:.{digits}g}", f"{now:.{digits}g}") for digits in range(4, 18)]
    return " -> ".join(next((pair for pair in texts if pair[0] != pair[1]), texts[-1]))
