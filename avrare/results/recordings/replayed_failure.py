"""Recordings of replayed rollouts: the stored failures of a run folder, and any other rollout."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from avrare.base.errors import UsageError, did_you_mean
from avrare.estimation.result.result import Failures
from avrare.results.recordings.recording import Recording
from avrare.results.run import Run
from avrare.results.stored_failures import select_failure
from avrare.rollout.problem import Problem
from avrare.rollout.replay import ReplayedRollout, replay_tape
from avrare.scenario.schema import Block


@dataclass(frozen=True)
class ReplayedFailure:
    """A stored failure of a run, replayed; ``changes`` are messages about robustness that differs now."""

    specification: str
    index: int
    recording: Recording
    changes: tuple[str, ...]


def replay_run_failure(
    run: Run, specification: str | None, index: int | None, rule: str | None = None
) -> ReplayedFailure:
    """Replay a stored failure of a run; without an index the least robust one, which also checks all others.

    Its specification is given by name or by its option ``rule``, or only one has failures.
    """
    problem = run.scenario.problem(run.scenario.specifications)
    if specification is None:
        specification = _find_rule(run, rule)
    elif specification not in problem.names:
        hint = did_you_mean(specification, problem.names)
        raise UsageError(f"{run.folder}: there is no specification {specification!r}", hint)
    name, chosen = select_failure(run, specification, index)
    failures = run[name].failures
    count = len(failures.robustness)
    indices = range(count) if index is None else [index]
    changes = _compare_robustness(problem.subset([name]), failures, indices)
    source = f"{run.folder}: failure {chosen} of {count} stored of {name}"
    rollout = replay_tape(problem, failures.noise[chosen])
    if rollout.error is not None:
        raise UsageError(f"{source}: the rollout ends with an error: {rollout.error}")
    return ReplayedFailure(name, chosen, record_rollout(problem, rollout, source), changes)


def record_rollout(problem: Problem, rollout: ReplayedRollout, source: str) -> Recording:
    """Return the recording of a rollout, up to its error if there is one."""
    scene, dt = problem.scene, 1.0 if problem.dt is None else problem.dt
    return Recording(source, dt, 0.0, rollout.signals, scene, () if scene is None else scene.names)


def _find_rule(run: Run, rule: str | None) -> str | None:
    parts = () if rule is None or run.definition is None else run.definition.specifications.items()
    names = [name for name, part in parts if isinstance(part, Block) and part.resolved.get("rule") == rule]
    return names[0] if len(names) == 1 else None


def _compare_robustness(problem: Problem, failures: Failures, indices: Sequence[int]) -> tuple[str, ...]:
    messages = []
    for begin in range(0, len(indices), problem.chunk):
        chosen = list(indices[begin : begin + problem.chunk])
        robustness = problem.robustness(failures.noise[chosen])
        for k, now in zip(chosen, robustness, strict=True):
            if now != (before := failures.robustness[k]):
                place = f"failure {k} of {problem.names[0]}"
                messages.append(f"{place}: robustness {now:.9g} now, {before:.9g} when stored")
    return tuple(messages)
