"""Replay of stored failures: one with all that differs, or all of a scenario before each of its runs.

The new failures of a run extend the database.
"""

from __future__ import annotations

import math
import os
import traceback
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from avrare.analysis.failures import FAILURES_FOLDER
from avrare.analysis.failures.failure import (
    Failure,
    compute_checksums,
    compute_fingerprints,
    make_failure,
    make_failure_of_run,
    round_values,
)
from avrare.analysis.failures.storage import FailureDatabase
from avrare.base.errors import UsageError, require_path
from avrare.base.records import Answer, Records
from avrare.estimation.loop.checkpoint import SCENARIO
from avrare.estimation.result.result import Failures
from avrare.protocols import Floats
from avrare.results.run import Run
from avrare.results.stored_failures import select_failure
from avrare.rollout.child_process import SystemCrashed, run_guarded
from avrare.rollout.loaded_scenario import LoadedScenario, load
from avrare.rollout.replay import ReplayedRollout, replay_tape, replay_tapes, tabulate_signals
from avrare.worlds.capabilities import capabilities
from avrare.worlds.step_timeout import StepTimeout, Watchdog

MAX_STORED = 10
"""Largest number of new failures of a specification stored from one run, the worst ones."""

_OUTCOMES = {"still fails": "still fail", "passes now": "pass now", "other error": "other errors"}
"""Words for the outcome of one failure -> of several."""
_MAX_NAMED = 3
"""Number of differing signals that are named; the others are counted."""


@dataclass(frozen=True, repr=False)
class FailureReplay(Answer):
    """Replay of a stored failure.

    Attributes:
        failure: The failure as it was stored.
        rollout: The rollout now; its ``outcome`` is "fails", "passes" or "error".
        changes: Messages about parts of the scenario and versions that have changed.
        divergence: First difference from the stored signals (without them, from the robustness); None:
            bit-identical.
        scenario: Scenario on which it was replayed.
    """

    failure: Failure
    rollout: ReplayedRollout
    changes: tuple[str, ...]
    divergence: str | None
    scenario: LoadedScenario

    def table(self) -> Records:
        """Return one row: the outcome now, and the differences."""
        row = {
            "failure": self.failure.id,
            "scenario": self.scenario.name,
            "specification": self.failure.specification,
            "outcome": self.rollout.outcome,
            "robustness": self.rollout.robustness,
            "stored": self.failure.robustness,
            "divergence": self.divergence,
            "changes": self.changes,
        }
        return Records([row])

    def lines(self) -> list[str]:
        """Describe the outcome and the changes."""
        failure, rollout = self.failure, self.rollout
        robustness = f"robustness {rollout.robustness:.6g}"
        outcomes = {
            "fails": f"failure {failure.id} is reproduced: {failure.specification} is violated, {robustness}",
            "passes": f"failure {failure.id} does not fail now: {failure.specification} holds, {robustness}",
            "error": f"failure {failure.id} ends with an error: {rollout.error}",
        }
        outcome = outcomes[rollout.outcome]
        if self.divergence is None:
            compared = "the signals are" if len(failure.checksums) else "the robustness is"
            return [outcome, f"{compared} bit-identical", *self.changes]
        no_change = "scenario and versions are the same: the machine or the code differs"
        return [outcome, self.divergence, *(self.changes or (no_change,))]


def replay(
    source: Run | str | os.PathLike[str],
    failure: Failure | str | int | None = None,
    specification: str | None = None,
    *,
    scenario: str | os.PathLike[str] | None = None,
    overrides: Sequence[str] = (),
    failures: str | os.PathLike[str] = FAILURES_FOLDER,
    safe: bool = False,
) -> FailureReplay:
    """Run a stored failure again, and tell whether it still fails, with the changes.

    Args:
        source: A run or its folder; or a scenario file, with the ID of a failure.
        failure: Index of a failure of the run (None: its least robust one), or ID in ``failures``.
        specification: Specification of the run's failure; None: the only one with failures.
        scenario: Another scenario file for the failure of a run.
        overrides: Settings of the scenario, as for ``--set``.
        failures: Folder of stored failures.
        safe: As for ``avrare.load``.

    Raises:
        UsageError: The failure is not stored, or does not fit the scenario.
    """
    if isinstance(source, Run) or Path(require_path(source, "a run or a scenario file")).is_dir():
        if not (failure is None or isinstance(failure, int)):
            raise UsageError(f"failure {failure!r}: a run's failures are numbered from 0", "give its index")
        run = source if isinstance(source, Run) else Run.read(source)
        name, index = select_failure(run, specification, failure)
        drives = run[name].failures
        stored = make_failure_of_run(
            run.scenario, name, drives.noise[index], float(drives.robustness[index]), run.versions
        )
        if scenario is None and not overrides:
            return replay_failure(run.scenario, stored)
        file = scenario or (run.folder and run.folder / SCENARIO)
        if file is None:
            raise UsageError("the run has no folder with its scenario", "name the scenario file")
        return replay_failure(load(file, overrides, safe), stored)
    if failure is None or isinstance(failure, int):
        raise UsageError(f"{source}: name a stored failure of this scenario", "give its ID, or a run folder")
    stored = failure if isinstance(failure, Failure) else FailureDatabase(Path(failures)).load(failure)
    return replay_failure(load(source, overrides, safe), stored)


def replay_error(run: Run, index: int, specification: str | None = None) -> FailureReplay:
    """Run a rollout of a run again that ended in an error.

    Raises:
        SystemCrashed: It ends its process, or takes longer than the scenario's ``rollout_timeout``.
        UsageError: The rollout does not exist.
    """
    tapes = {name: result.error_tapes for name, result in run.items() if specification in (None, name)}
    stored = [(name, tape) for name, of_specification in tapes.items() for tape in of_specification]
    if not 0 <= index < len(stored):
        hint = "rollouts that ended in an error are numbered from 0"
        raise UsageError(f"{run.name}: there is no error {index}: {len(stored)} of them are stored", hint)
    name, tape = stored[index]
    failure = make_failure_of_run(run.scenario, name, tape, math.nan, run.versions)
    problem = run.scenario.problem(name)
    try:
        with Watchdog(problem.rollout_timeout) as watchdog:
            guarded = partial(watchdog.call, replay_failure, run.scenario, failure)
            return run_guarded("the replay", problem.system, guarded)
    except StepTimeout as timeout:
        raise SystemCrashed(
            f"the rollout takes more than {problem.rollout_timeout:g} s: it hangs {_find_line(timeout)}",
            "mend that line, or raise `rollout_timeout`",
        ) from timeout


def _find_line(timeout: StepTimeout) -> str:
    alarm = timeout.__context__
    frames = traceback.extract_tb(alarm.__traceback__ if alarm else None)
    line = frames[-2]  # the last one is that of the alarm
    return f"at {os.path.relpath(line.filename)}:{line.lineno} in {line.name}"


def replay_failure(scenario: LoadedScenario, failure: Failure) -> FailureReplay:
    """Replay a stored failure on its scenario, or on a changed one.

    UsageError if the scenario has no such specification, or needs noise of another shape.
    """
    problem = scenario.problem(failure.specification)
    changes = _find_changes(scenario, failure)
    expected = (problem.steps + 1, problem.noise_size)
    if failure.noise.shape != expected:
        stored, needed = (" x ".join(map(str, shape)) for shape in (failure.noise.shape, expected))
        text = f"failure {failure.id} has {stored} numbers of noise, but {scenario.name} needs {needed}"
        raise UsageError(text, "; ".join(changes) or None)
    rollout = replay_tape(problem, failure.noise)
    return FailureReplay(failure, rollout, changes, _find_divergence(failure, rollout, scenario), scenario)


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
    texts = [
        f"{failure.columns[k]} {_format_change(float(then[step, k]), float(now[step, k]))}"
        for k in columns[:_MAX_NAMED]
    ]
    rest = f" and {len(columns) - _MAX_NAMED} more" if len(columns) > _MAX_NAMED else ""
    onset = f", visibly from step {step} on" if step > first else ""
    return f"{onset}: {', '.join(texts)}{rest}"


def _format_change(then: float, now: float) -> str:
    # as many digits as it takes to tell them apart
    texts = [(f"{then:.{digits}g}", f"{now:.{digits}g}") for digits in range(4, 18)]
    return " -> ".join(next((pair for pair in texts if pair[0] != pair[1]), texts[-1]))


@dataclass(frozen=True)
class KnownFailure:
    """A stored failure and its outcome when replayed."""

    failure: Failure
    outcome: str  # ``still fails``, ``passes now`` or ``other error``
    robustness: float | None  # now; None if the rollout could not be completed
    reason: str | None = None  # of ``other error``

    def line(self) -> str:
        """Return, for example, ``3f2a91bc safe_distance: still fails (robustness -0.12, was -0.12)``."""
        failure = self.failure
        if self.robustness is None:
            return f"{failure.id} {failure.specification}: {self.outcome}: {self.reason}"
        now = f"robustness {self.robustness:.3g}, was {failure.robustness:.3g}"
        return f"{failure.id} {failure.specification}: {self.outcome} ({now})"


def replay_failures(scenario: LoadedScenario, failures: Sequence[Failure]) -> list[KnownFailure]:
    """Replay stored failures, a chunk of the scenario at a time; results in the same order."""
    outcomes = {}
    for name in dict.fromkeys(failure.specification for failure in failures):
        same = [failure for failure in failures if failure.specification == name]
        outcomes[name] = iter(_replay_specification(scenario, name, same))
    return [next(outcomes[failure.specification]) for failure in failures]


def _replay_specification(scenario: LoadedScenario, name: str, failures: list[Failure]) -> list[KnownFailure]:
    if name not in scenario.specifications:
        reason = f"the scenario has no specification {name!r} any more"
        return [KnownFailure(failure, "other error", None, reason) for failure in failures]
    problem = scenario.problem(name)
    shape = (problem.steps + 1, problem.noise_size)
    fitting = [failure for failure in failures if failure.noise.shape == shape]
    replays: dict[str, KnownFailure] = {}
    for begin in range(0, len(fitting), problem.chunk):
        part = fitting[begin : begin + problem.chunk]
        outcome = problem.replay(np.stack([failure.noise for failure in part]))
        for k, failure in enumerate(part):
            text = "still fails" if outcome.violated[k, 0] else "passes now"
            now = KnownFailure(failure, text, float(outcome.robustness[k, 0]))
            if outcome.error[k]:
                now = KnownFailure(failure, "other error", None, "the rollout ends with an error")
            replays[failure.id] = now
    mismatch = f"the scenario needs {shape[0]} x {shape[1]} numbers of noise now"
    return [replays.get(f.id) or KnownFailure(f, "other error", None, mismatch) for f in failures]


def check_known_failures(database: FailureDatabase, scenario: LoadedScenario) -> list[str]:
    """Replay the stored failures of a scenario and return a line for each outcome, with a summary.

    UsageError if new failures could not be added to the database.
    """
    database.ensure_writable()
    failures, messages = database.load_all(scenario.name)
    replays = replay_failures(scenario, failures)
    if not replays:
        return messages
    counts = {outcome: sum(replayed.outcome == outcome for replayed in replays) for outcome in _OUTCOMES}
    summary = ", ".join(
        f"{count} {outcome if count == 1 else _OUTCOMES[outcome]}"
        for outcome, count in counts.items()
        if count
    )
    return [
        *messages,
        *(replayed.line() for replayed in replays),
        f"known failures of {scenario.name}: {summary}",
    ]


def store_worst(
    database: FailureDatabase, scenario: LoadedScenario, failures_by_name: Mapping[str, Failures]
) -> tuple[list[str], list[str]]:
    """Add the worst failures of a run, ``MAX_STORED`` of each specification, to a database.

    Returns the ids of the failures that were not stored before, and a line for each specification with
    failures that cannot be stored because they do not fail again on their noise.
    """
    new, messages = [], []
    for name, failures in failures_by_name.items():
        order = np.argsort(failures.robustness, kind="stable")[:MAX_STORED]
        if not len(order):
            continue
        problem, tapes, lost = scenario.problem(name), failures.noise[order], 0
        for k, tape, rollout in zip(order, tapes, replay_tapes(problem, tapes), strict=True):
            if rollout.outcome != "fails":  # some estimators count robustness 0 as a failure
                lost += failures.robustness[k] < 0.0
                continue
            failure = make_failure(scenario, name, tape, rollout)
            if database.add(failure):
                new.append(failure.id)
        if lost:
            provided = capabilities(problem.system)
            text = f"{name}: {lost} of its failures cannot be stored: they do not fail again on their noise"
            messages.append(text if provided.noise else f"{text}; {provided.reason}")
    return new, messages
