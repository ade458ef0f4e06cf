"""Recordings from the folder of a run: a stored failure driven again from its noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from avrare.build.scenario import BuildableScenario
from avrare.errors import UsageError, did_you_mean
from avrare.estimation.result import Failures
from avrare.protocols import Floats
from avrare.record.failures import read_failures
from avrare.record.trace import Recording
from avrare.scenario.load import load


@dataclass(frozen=True)
class Replay:
    """A stored failure, driven again.

    Attributes:
        scenario: As it was run.
        specification: Whose failure it is.
        index: Its place among the stored failures.
        recording: The drive.
        differing: Messages on the stored failures whose robustness is another one now.
    """

    scenario: BuildableScenario
    specification: str
    index: int
    recording: Recording
    differing: tuple[str, ...]


def replay(folder: Path, specification: str | None, index: int | None, rule: str | None = None) -> Replay:
    """Drive a stored failure of a run again.

    Args:
        folder: Of the run.
        specification: Whose failure; None where ``rule`` tells it or only one has failures.
        index: Which; None for the one with the least robustness, with all of them checked.
        rule: Option ``rule`` of the specification whose failure it is, in place of its name.

    Raises:
        UsageError: The folder is none of a run, or there is no such failure.
    """
    if not (folder / "scenario.yaml").is_file():
        raise UsageError(f"{folder}: no scenario.yaml in it", "give the folder that `avrare run` has written")
    scenario = BuildableScenario(load(folder / "scenario.yaml"))
    stored = read_failures(folder)
    name = _chosen(
        folder, scenario, stored, _of_rule(scenario, rule) if specification is None else specification
    )
    failures = stored[name]
    count = len(failures.robustness)
    if index is not None and not 0 <= index < count:
        raise UsageError(f"{folder}: {name} has no failure {index}", f"its {count} failures count from 0")
    checked = range(count) if index is None else [index]
    differing = _compare(scenario, name, failures, checked)
    chosen = int(np.argmin(failures.robustness)) if index is None else index
    source = f"{folder}: failure {chosen} of {count} stored of {name}"
    recording = drive(scenario, failures.noise[chosen], source)
    return Replay(scenario, name, chosen, recording, differing)


def drive(scenario: BuildableScenario, tape: Floats, source: str) -> Recording:
    """The recording of one noise tape (steps + 1, noise_size).

    Raises:
        UsageError: The rollout breaks down.
    """
    stack = scenario.stack
    outcome = scenario.problem(scenario.specifications).replay(tape[None], keep_carries=True)
    if outcome.error.any():
        raise UsageError(f"{source}: it breaks down: {'; '.join(outcome.messages)}")
    samples = [stack.loop.signals(carry.system) for _, _, carry in outcome.carries]
    signals = {key: np.concatenate([sample[key] for sample in samples]) for key in samples[0]}
    names = stack.scene.names if stack.scene is not None else ()
    return Recording(source, float(stack.loop.simulator.dt), 0.0, signals, stack.scene, names)


def _chosen(
    folder: Path, scenario: BuildableScenario, stored: dict[str, Failures], specification: str | None
) -> str:
    known = scenario.specifications
    if specification is not None and specification not in known:
        hint = did_you_mean(specification, known)
        raise UsageError(f"{folder}: there is no specification {specification!r}", hint)
    listing = ", ".join(f"{name} ({len(found.robustness)})" for name, found in stored.items())
    if not stored or (specification is not None and specification not in stored):
        what = f"of {specification} " if stored else ""
        hint = (
            f"stored: {listing}"
            if stored
            else "none was seen; run more rollouts, or an estimator for rare events"
        )
        raise UsageError(f"{folder}: no failure {what}is stored", hint)
    if specification is None and len(stored) > 1:
        raise UsageError(f"{folder}: whose failure?", f"choose it with --specification: {listing}")
    return next(iter(stored)) if specification is None else specification


def _of_rule(scenario: BuildableScenario, rule: str | None) -> str | None:
    """The only specification whose option ``rule`` is this one."""
    parts = scenario.definition.specifications.items()
    found = [
        name
        for name, part in parts
        if rule is not None and getattr(getattr(part, "config", None), "rule", None) == rule
    ]
    return found[0] if len(found) == 1 else None


def _compare(
    scenario: BuildableScenario, name: str, failures: Failures, indices: Sequence[int]
) -> tuple[str, ...]:
    """Drive stored failures again and name those that come out differently."""
    problem = scenario.problem(name)
    messages = []
    chunk = scenario.definition.chunk
    for begin in range(0, len(indices), chunk):
        part = list(indices[begin : begin + chunk])
        now = problem.robustness(failures.noise[part])
        for k, value in zip(part, now, strict=True):
            before = failures.robustness[k]
            if value != before:
                messages.append(
                    f"failure {k} of {name}: robustness {value:.9g} now, {before:.9g} when it was stored"
                )
    return tuple(messages)
