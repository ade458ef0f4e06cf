"""Regression test of stored failures: replayed before every run, and extended by its new failures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from avrare.analysis.failures.failure import Failure, make_failure
from avrare.analysis.failures.storage import FailureDatabase
from avrare.estimation.result import Failures
from avrare.rollout.loaded_scenario import LoadedScenario
from avrare.rollout.replay import replay_tapes
from avrare.worlds.capabilities import capabilities

MAX_STORED = 10
"""Largest number of new failures of a specification stored from one run, the worst ones."""

_OUTCOMES = ("still fails", "passes now", "other error")


@dataclass(frozen=True)
class KnownFailure:
    """A stored failure and its outcome now.

    Attributes:
        failure: Failure as it was stored.
        outcome: ``still fails``, ``passes now`` or ``other error``.
        robustness: Robustness now; None if the rollout could not be completed.
        reason: Reason for ``other error``, otherwise None.
    """

    failure: Failure
    outcome: str
    robustness: float | None
    reason: str | None = None

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
    found: dict[str, KnownFailure] = {}
    for begin in range(0, len(fitting), problem.chunk):
        part = fitting[begin : begin + problem.chunk]
        outcome = problem.replay(np.stack([failure.noise for failure in part]))
        for k, failure in enumerate(part):
            text = "still fails" if outcome.violated[k, 0] else "passes now"
            now = KnownFailure(failure, text, float(outcome.robustness[k, 0]))
            if outcome.error[k]:
                now = KnownFailure(failure, "other error", None, "the rollout ends with an error")
            found[failure.id] = now
    mismatch = f"the scenario needs {shape[0]} x {shape[1]} numbers of noise now"
    return [found.get(f.id) or KnownFailure(f, "other error", None, mismatch) for f in failures]


def check_known_failures(database: FailureDatabase, scenario: LoadedScenario) -> list[str]:
    """Replay the stored failures of a scenario and return a line for each outcome, with a summary.

    Raises:
        UsageError: New failures could not be added to the database.
    """
    database.ensure_writable()
    failures, messages = database.load_all(scenario.name)
    found = replay_failures(scenario, failures)
    if not found:
        return messages
    counts = {outcome: sum(one.outcome == outcome for one in found) for outcome in _OUTCOMES}
    summary = ", ".join(f"{count} {outcome}" for outcome, count in counts.items() if count)
    return [*messages, *(one.line() for one in found), f"known failures of {scenario.name}: {summary}"]


def store_worst(
    database: FailureDatabase,
    scenario: LoadedScenario,
    found: Mapping[str, Failures],
    limit: int = MAX_STORED,
) -> tuple[list[str], list[str]]:
    """Add the worst failures of a run, ``limit`` of each specification, to a database.

    Returns:
        Ids of the failures that were not stored before, and a line for each specification with failures that
        cannot be stored because they do not fail again on their noise.

    Raises:
        UsageError: The database cannot be written to, or the tapes do not fit the scenario.
    """
    new, messages = [], []
    for name, failures in found.items():
        order = np.argsort(failures.robustness, kind="stable")[:limit]
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
