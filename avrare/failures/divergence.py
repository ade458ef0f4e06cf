"""What is different where a stored failure does not come out as it was."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np

from avrare.build.scenario import BuildableScenario
from avrare.errors import UsageError
from avrare.failures.driving import Drive, drive
from avrare.failures.failure import Failure, checksums, coarse, fingerprints, table
from avrare.protocols import Floats

_NAMED = 3
"""So many diverging signals are named; the others are counted."""
_DIGITS = range(4, 18)


@dataclass(frozen=True)
class Replayed:
    """A stored failure driven again.

    Attributes:
        failure: As it was stored.
        drive: As it is now.
        differing: Messages on parts and versions that are others now.
        divergence: Where the signals leave the stored ones, or None: they are the same to the last bit, or,
            where no signals are stored, the robustness is.
    """

    failure: Failure
    drive: Drive
    differing: tuple[str, ...]
    divergence: str | None


def replay(scenario: BuildableScenario, failure: Failure) -> Replayed:
    """Drive a stored failure on a scenario, the one that it was found on or a changed one.

    Raises:
        UsageError: The scenario has no such specification, or needs noise of another shape.
    """
    problem = scenario.problem(failure.specification)
    differing = differences(scenario, failure)
    expected = (problem.steps + 1, problem.noise_size)
    if failure.noise.shape != expected:
        raise UsageError(
            f"failure {failure.id}: it has {_by(failure.noise.shape)} numbers of noise, but {scenario.name} "
            f"needs {_by(expected)}",
            "; ".join(differing) or None,
        )
    found = drive(problem, failure.noise)
    return Replayed(failure, found, differing, divergence(failure, found, scenario))


def differences(scenario: BuildableScenario, failure: Failure) -> tuple[str, ...]:
    """Which fingerprints and versions are others than when the failure was stored."""
    now, versions = fingerprints(scenario.definition, failure.specification), scenario.definition.versions
    changed = [
        f"{name} differs: fingerprint {failure.parts.get(name, 'none')} -> {value}"
        for name, value in now.items()
        if failure.parts.get(name) != value
    ]
    if failure.scenario != scenario.name:
        changed.insert(0, f"the scenario is called {failure.scenario} -> {scenario.name}")
    # Of the same parts, a plugin that is there only once is that of an estimator.
    names = {*failure.versions, *versions} if changed else {*failure.versions} & {*versions}
    return (*changed, *_versions(failure.versions, versions, names))


def divergence(failure: Failure, found: Drive, scenario: BuildableScenario) -> str | None:
    """The first step at which the signals are others, and which they are; None where there is none."""
    if not len(failure.checksums):
        same = found.robustness == failure.robustness
        return None if same else f"robustness differs: {_pair(failure.robustness, found.robustness)}"
    columns, values = table(found.signals, scenario)
    if found.signals and columns != failure.columns:
        gone = [f"no {name}" for name in failure.columns if name not in columns]
        new = [name for name in columns if name not in failure.columns]
        return f"the signals are others: {', '.join(gone[:_NAMED] + new[:_NAMED])}"
    now = checksums(found.signals)
    differs = np.flatnonzero(now != failure.checksums[: len(now)])
    if len(differs):
        return f"the signals differ from step {differs[0]} on{_changes(failure, values, int(differs[0]))}"
    if len(now) < len(failure.checksums):
        return f"it breaks down at step {len(now)}, where it did not"
    return None


def _changes(failure: Failure, values: Floats, first: int) -> str:
    """What differs: at the first step, or at the first where it can be seen in the stored digits."""
    if not len(failure.values):
        return ""
    now = coarse(values)
    then = failure.values[: len(now)]
    changed = (then != now) & ~(np.isnan(then) & np.isnan(now))
    seen = np.flatnonzero(changed.any(axis=1))
    if not len(seen):
        return ", by less than a part in 4000"
    step = int(seen[0])
    columns = np.flatnonzero(changed[step])
    pairs = [(failure.columns[k], float(then[step, k]), float(now[step, k])) for k in columns[:_NAMED]]
    words = [f"{name} {_pair(before, after)}" for name, before, after in pairs]
    rest = f" and {len(columns) - _NAMED} more" if len(columns) > _NAMED else ""
    late = f", visibly from step {step} on" if step > first else ""
    return f"{late}: {', '.join(words)}{rest}"


def _pair(then: float, now: float) -> str:
    """Both with so many digits that they differ."""
    texts = [(f"{then:.{digits}g}", f"{now:.{digits}g}") for digits in _DIGITS]
    return " -> ".join(next((pair for pair in texts if pair[0] != pair[1]), texts[-1]))


def _versions(then: Mapping[str, str], now: Mapping[str, str], names: Collection[str]) -> list[str]:
    return [
        f"{name} {then.get(name, 'none')} -> {now.get(name, 'none')}"
        for name in sorted(names)
        if then.get(name) != now.get(name)
    ]


def _by(shape: tuple[int, ...]) -> str:
    return " x ".join(map(str, shape))
