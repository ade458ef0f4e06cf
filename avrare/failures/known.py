"""Failures that are known already: driven first in every run, and joined by the new ones."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from avrare.build.scenario import BuildableScenario
from avrare.estimation.result import Failures
from avrare.failures.database import Database
from avrare.failures.driving import drives
from avrare.failures.failure import Failure, kept
from avrare.rollout.problem import Problem
from avrare.worlds.capabilities import capabilities

KEPT = 10
"""So many new failures of a specification are kept from one run, the worst."""


OUTCOMES = ("still fails", "passes now", "other error")


@dataclass(frozen=True)
class Known:
    """How a stored failure comes out now.

    Attributes:
        failure: As it was stored.
        outcome: One of ``OUTCOMES``.
        robustness: Now; None where it could not be driven to the end.
        reason: Why it is an error, else None.
    """

    failure: Failure
    outcome: str
    robustness: float | None
    reason: str | None = None

    def line(self) -> str:
        """For example ``3f2a91bc safe_distance: still fails (robustness -0.12, was -0.12)``."""
        failure = self.failure
        if self.robustness is None:
            return f"{failure.id} {failure.specification}: {self.outcome}: {self.reason}"
        now = f"robustness {self.robustness:.3g}, was {failure.robustness:.3g}"
        return f"{failure.id} {failure.specification}: {self.outcome} ({now})"


def rerun(scenario: BuildableScenario, failures: Sequence[Failure]) -> list[Known]:
    """Drive stored failures again, as many at once as the scenario's chunk; in their order."""
    found: dict[int, Known] = {}
    for name in dict.fromkeys(failure.specification for failure in failures):
        places = [k for k, failure in enumerate(failures) if failure.specification == name]
        outcomes = _rerun(scenario, name, [failures[k] for k in places])
        found |= dict(zip(places, outcomes, strict=True))
    return [found[k] for k in range(len(failures))]


def _rerun(scenario: BuildableScenario, name: str, failures: list[Failure]) -> list[Known]:
    if name not in scenario.specifications:
        reason = f"the scenario has no specification {name!r} any more"
        return [Known(failure, "other error", None, reason) for failure in failures]
    problem = scenario.problem(name)
    shape = (problem.steps + 1, problem.noise_size)
    fit = [failure for failure in failures if failure.noise.shape == shape]
    driven: dict[str, Known] = {}
    for begin in range(0, len(fit), problem.chunk):
        part = fit[begin : begin + problem.chunk]
        outcome = problem.replay(np.stack([failure.noise for failure in part]))
        for k, failure in enumerate(part):
            if outcome.error[k]:
                driven[failure.id] = Known(failure, "other error", None, "it breaks down")
            else:
                words = "still fails" if outcome.violated[k, 0] else "passes now"
                driven[failure.id] = Known(failure, words, float(outcome.robustness[k, 0]))
    other = f"the scenario needs {shape[0]} x {shape[1]} numbers of noise now"
    return [driven.get(f.id) or Known(f, "other error", None, other) for f in failures]


def known_lines(database: Database, scenario: BuildableScenario) -> list[str]:
    """Drive the failures of a scenario that are in a database, and say how each comes out now.

    Raises:
        UsageError: No new ones could be added to it.
    """
    database.check()
    failures, complaints = database.all(scenario.name)
    found = rerun(scenario, failures)
    if not found:
        return complaints
    counts = {word: sum(one.outcome == word for one in found) for word in OUTCOMES}
    summary = ", ".join(f"{count} {word}" for word, count in counts.items() if count)
    return [*complaints, *(one.line() for one in found), f"known failures of {scenario.name}: {summary}"]


def remember(
    database: Database, scenario: BuildableScenario, found: Mapping[str, Failures], most: int = KEPT
) -> tuple[list[str], list[str]]:
    """Add the worst failures of a run to a database.

    Args:
        database: Where to.
        scenario: That was run.
        found: Specification -> its failures.
        most: Failures of each specification that are kept.

    Returns:
        Ids of those that were not there yet; and a line for each specification of which some cannot be kept,
        because they do not fail again on their noise.

    Raises:
        UsageError: The database cannot be written to, or the tapes do not fit the scenario.
    """
    new, complaints = [], []
    for name, failures in found.items():
        order = np.argsort(failures.robustness, kind="stable")[:most]
        if not len(order):
            continue
        problem, tapes, lost = scenario.problem(name), failures.noise[order], 0
        for k, tape, driven in zip(order, tapes, drives(problem, tapes), strict=True):
            if driven.outcome != "fails":  # robustness 0 is a failure for some estimators, and no violation
                lost += failures.robustness[k] < 0.0
                continue
            failure = kept(scenario, name, tape, driven)
            if database.add(failure):
                new.append(failure.id)
        if lost:
            complaints.append(f"{name}: {lost} of its failures cannot be kept: {_why_lost(problem)}")
    return new, complaints


def _why_lost(problem: Problem) -> str:
    can = capabilities(problem.system)
    return "they do not fail again on their noise" + ("" if can.noise else f"; {can.reason}")
