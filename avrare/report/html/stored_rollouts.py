"""Rollouts of a run folder that a report shows: selected, replayed, monitored, continued without noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from avrare.analysis.failures.lost import Continuations, continue_without_noise
from avrare.analysis.monitor.monitoring import MonitoringResult, monitor_recording
from avrare.base.errors import AvrareError, UsageError
from avrare.estimation.result import Result
from avrare.protocols import Floats
from avrare.report.plots.rollout_plot import Frame, extract_frames
from avrare.results.recordings.replayed_failure import record_rollout
from avrare.results.stored_causes import StoredKinds
from avrare.rollout.problem import Problem
from avrare.rollout.replay import ReplayedRollout, replay_tapes

_MAX_KINDS = 4
"""Kinds of one specification whose most typical failure is shown."""


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
    shown = [] if kinds is None else [one for one in kinds.kinds if 0 <= one.representative < count]
    for one in shown[:_MAX_KINDS]:
        titles[one.representative] = f"Most typical failure of kind {one.kind}"
        numbers[one.representative] = one.kind
    worst = int(np.argmin(failures.robustness))
    titles[worst] = f"{titles[worst]}, and the worst" if worst in titles else "Worst failure"
    if not shown:
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


def replay_stored(problem: Problem, stored: Sequence[StoredRollout]) -> list[MonitoredRollout]:
    """Replay rollouts in one batch and monitor them."""
    if not stored:
        return []
    if len({one.tape.shape for one in stored}) > 1:
        raise UsageError("the stored tapes have different shapes", "run the scenario again")
    missing = [one.specification for one in stored if one.specification not in problem.names]
    if missing:
        raise UsageError(f"its scenario.yaml has no specification {missing[0]!r}", "run the scenario again")
    rollouts = replay_tapes(problem, np.stack([one.tape for one in stored]))
    return [_monitor(problem, one, rollout) for one, rollout in zip(stored, rollouts, strict=True)]


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


def with_continuations(problem: Problem, rollouts: Sequence[MonitoredRollout]) -> list[MonitoredRollout]:
    """Return the rollouts, the failing ones with their continuations without noise."""
    return [_continue(problem, one) if _fails(one) else one for one in rollouts]


def _fails(rollout: MonitoredRollout) -> bool:
    return rollout.stored.failed and rollout.result is not None and rollout.result.violated


def _continue(problem: Problem, rollout: MonitoredRollout) -> MonitoredRollout:
    alone = problem.subset([rollout.stored.specification])
    try:
        return replace(rollout, continuations=continue_without_noise(alone, rollout.stored.tape))
    except AvrareError as error:  # the replay itself is shown all the same
        return replace(rollout, not_continued=error.message)
