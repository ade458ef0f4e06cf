"""Recordings of replayed rollouts: the stored failures of a run folder, and any other rollout."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from avrare.base.errors import UsageError, did_you_mean
from avrare.estimation.result import Failures
from avrare.results.reader import load_run_scenario, read_failures, select_failure
from avrare.results.recordings.recording import Recording
from avrare.rollout.loaded_scenario import LoadedScenario
from avrare.rollout.problem import Problem
from avrare.rollout.replay import ReplayedRollout, replay_tape


@dataclass(frozen=True)
class ReplayedFailure:
    """A stored failure of a run, replayed; ``changes`` are messages about robustness that differs now."""

    scenario: LoadedScenario
    specification: str
    index: int
    recording: Recording
    changes: tuple[str, ...]


def replay_run_failure(
    folder: Path, specification: str | None, index: int | None, rule: str | None = None
) -> ReplayedFailure:
    """Replay a stored failure of a run; without an index the least robust one, which also checks all others.

    Its specification is given by name or by its option ``rule``, or only one has failures.
    """
    scenario = load_run_scenario(folder)
    if specification is None:
        specification = _find_rule(scenario, rule)
    elif specification not in scenario.specifications:
        hint = did_you_mean(specification, scenario.specifications)
        raise UsageError(f"{folder}: there is no specification {specification!r}", hint)
    stored = read_failures(folder)
    name, chosen = select_failure(folder, stored, specification, index)
    failures = stored[name]
    count = len(failures.robustness)
    changes = _compare_robustness(scenario, name, failures, range(count) if index is None else [index])
    source = f"{folder}: failure {chosen} of {count} stored of {name}"
    problem = scenario.problem(scenario.specifications)
    rollout = replay_tape(problem, failures.noise[chosen])
    if rollout.error is not None:
        raise UsageError(f"{source}: the rollout ends with an error: {rollout.error}")
    recording = record_rollout(problem, rollout, source)
    return ReplayedFailure(scenario, name, chosen, recording, changes)


def record_rollout(problem: Problem, rollout: ReplayedRollout, source: str) -> Recording:
    """Return the recording of a rollout, up to its error if there is one."""
    scene, dt = problem.scene, 1.0 if problem.dt is None else problem.dt
    return Recording(source, dt, 0.0, rollout.signals, scene, () if scene is None else scene.names)


def _find_rule(scenario: LoadedScenario, rule: str | None) -> str | None:
    parts = scenario.definition.specifications.items()
    found = [name for name, part in parts if getattr(getattr(part, "config", None), "rule", None) == rule]
    return found[0] if rule is not None and len(found) == 1 else None


def _compare_robustness(
    scenario: LoadedScenario, name: str, failures: Failures, indices: Sequence[int]
) -> tuple[str, ...]:
    problem = scenario.problem(name)
    messages = []
    for begin in range(0, len(indices), problem.chunk):
        part = list(indices[begin : begin + problem.chunk])
        robustness = problem.robustness(failures.noise[part])
        for k, now in zip(part, robustness, strict=True):
            if now != (before := failures.robustness[k]):
                messages.append(f"failure {k} of {name}: robustness {now:.9g} now, {before:.9g} when stored")
    return tuple(messages)
