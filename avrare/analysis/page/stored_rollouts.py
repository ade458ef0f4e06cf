"""Rollouts of a run folder that a report shows: selected, replayed, monitored, continued without noise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from avrare.analysis.failures.noise_free_continuation import Continuations, continue_without_noise
from avrare.analysis.monitor.monitoring import MonitoringResult, monitor_recording
from avrare.base.errors import AvrareError, UsageError
from avrare.estimation.result.result import Result
from avrare.protocols import Floats
from avrare.results.recordings import record_rollout
from avrare.results.run import Run
from avrare.results.stored_causes import StoredKinds
from avrare.rollout.problem import Problem
from avrare.rollout.replay import Frame, ReplayedRollout, extract_frames, replay_tapes


@dataclass(frozen=True)
class StoredRollout:
    """A stored rollout with its tape (steps + 1, noise_size); ``title`` says why it is shown.

    ``index`` is its number among the stored failures, ``kind`` that of the kind that it stands for, from 1.
    """

    title: str
    specification: str
    tape: Floats
    robustness: float
    failed: bool
    index: int | None = None
    kind: int | None = None

    @property
    def norm(self) -> float:
        """Norm of the noise; the smaller, the more likely."""
        return float(np.sqrt(np.square(self.tape).sum()))


@dataclass(frozen=True)
class MonitoredRollout:
    """A stored rollout, replayed and monitored.

    Without a result it cannot be shown, for the reason ``problem``; without vehicles it has no frames.
    ``continuations`` tell when it was lost; None where that was too much to compute, or could not be, for the
    reason ``not_continued``.
    """

    stored: StoredRollout
    result: MonitoringResult | None
    frames: tuple[Frame, ...] = ()
    problem: str = ""
    continuations: Continuations | None = None
    not_continued: str = ""

    @property
    def violation(self) -> int | None:
        """Sample of the first violation; None where there is none, or it is unknown."""
        first = self.result.first if self.result is not None else None
        return None if first is None else first.sample


def select_rollouts(result: Result, kinds: StoredKinds | None = None) -> list[StoredRollout]:
    """Return each kind's most typical failure, and the worst; or the rollout nearest to a failure.

    Without kinds the second one is that with the smallest noise.
    """
    name, failures = result.specification, result.failures
    if not len(failures.robustness):
        noise, robustness = result.worst.noise, result.worst.robustness
        if not noise.size or np.isnan(robustness):
            return []
        return [StoredRollout("Nearest to a failure", name, noise, robustness, False)]
    titles: dict[int, str] = {}
    numbers: dict[int, int] = {}
    count = len(failures.robustness)
    chosen = [] if kinds is None else [kind for kind in kinds.kinds if 0 <= kind.representative < count]
    for kind in chosen[:4]:
        titles[kind.representative] = f"Most typical failure of kind {kind.kind}"
        numbers[kind.representative] = kind.kind
    worst = int(np.argmin(failures.robustness))
    titles[worst] = f"{titles[worst]}, and the worst" if worst in titles else "Worst failure"
    if not chosen:
        smallest = int(np.argmin(np.square(failures.noise).sum(axis=(1, 2))))
        titles[smallest] = (
            "Worst failure, and the one with the smallest noise"
            if smallest == worst
            else "Failure with the smallest noise"
        )
    return [
        StoredRollout(title, name, failures.noise[k], float(failures.robustness[k]), True, k, numbers.get(k))
        for k, title in titles.items()
    ]


def replay_rollouts(
    run: Run, kinds: Mapping[str, StoredKinds]
) -> tuple[dict[str, list[MonitoredRollout]], tuple[str, ...]]:
    """Return the rollouts to show of each specification, replayed in one batch and monitored.

    Failing ones have their continuations without noise, where these take less than two minutes.

    Returns:
        The rollouts by specification, of those that have any, and lines that say why there are none.
    """
    stored = [chosen for name, result in run.items() for chosen in select_rollouts(result, kinds.get(name))]
    monitored: dict[str, list[MonitoredRollout]] = {rollout.specification: [] for rollout in stored}
    if run.build_errors or not stored:
        return monitored, run.build_errors
    problem = run.problem
    try:
        _check_tapes(problem, stored)
        replayed = replay_tapes(problem, np.stack([rollout.tape for rollout in stored]))
        continued = _predict_seconds(run, len(stored), problem.steps) <= 120.0  # [s]
        for rollout, replay in zip(stored, replayed, strict=True):
            judged = _monitor(problem, rollout, replay)
            monitored[rollout.specification].append(_continue(problem, judged) if continued else judged)
    except AvrareError as error:
        return {name: [] for name in monitored}, tuple(error.lines())
    return monitored, ()


def _check_tapes(problem: Problem, stored: Sequence[StoredRollout]) -> None:
    if len({rollout.tape.shape for rollout in stored}) > 1:
        raise UsageError("the stored tapes have different shapes", "run the scenario again")
    missing = [rollout.specification for rollout in stored if rollout.specification not in problem.names]
    if missing:
        raise UsageError(f"its scenario.yaml has no specification {missing[0]!r}", "run the scenario again")


def _predict_seconds(run: Run, shown: int, steps: int) -> float:
    # of all continuations without noise, from the cost of the run's rollouts
    each = max(result.seconds / max(result.rollouts, 1) for result in run.values())
    return each * shown * (steps + 2)


def _monitor(problem: Problem, stored: StoredRollout, rollout: ReplayedRollout) -> MonitoredRollout:
    if rollout.error is not None:
        text = f"the rollout ended with an error after {len(rollout.states)} samples"
        return MonitoredRollout(stored, None, problem=text)
    recording = record_rollout(problem, rollout, stored.title)
    specification = problem.monitor(stored.specification)
    try:
        result = monitor_recording(stored.specification, specification, recording)
    except AvrareError as error:
        return MonitoredRollout(stored, None, problem=error.message)
    return MonitoredRollout(stored, result, tuple(extract_frames(problem, rollout)))


def _continue(problem: Problem, rollout: MonitoredRollout) -> MonitoredRollout:
    if not (rollout.stored.failed and rollout.result is not None and rollout.result.violated):
        return rollout
    alone = problem.subset([rollout.stored.specification])
    try:
        return replace(rollout, continuations=continue_without_noise(alone, rollout.stored.tape))
    except AvrareError as error:  # the replay itself is shown all the same
        return replace(rollout, not_continued=error.message)
