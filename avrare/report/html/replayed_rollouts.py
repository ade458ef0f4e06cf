"""Rollouts shown in a report: selected from the stored ones, replayed and monitored."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from avrare.analysis.monitor.monitoring import MonitoringResult, monitor_recording
from avrare.base.errors import AvrareError, UsageError
from avrare.estimation.result import Failures
from avrare.protocols import Floats
from avrare.report.plots.drive_plot import Frame, extract_frames
from avrare.results.recordings.replayed_failure import record_rollout
from avrare.results.stored_rollouts import RolloutSample
from avrare.rollout.loaded_scenario import LoadedScenario
from avrare.rollout.replay import ReplayedRollout, replay_tapes


@dataclass(frozen=True)
class StoredRollout:
    """A stored rollout selected for a report.

    Attributes:
        title: Heading, which says why it is shown.
        specification: Name of its specification.
        tape: (steps + 1, noise_size).
        robustness: Stored robustness.
        failed: The rollout is a failure.
    """

    title: str
    specification: str
    tape: Floats
    robustness: float
    failed: bool

    @property
    def norm(self) -> float:
        """Norm of the noise; the smaller, the more likely."""
        return float(np.sqrt(np.square(self.tape).sum()))


@dataclass(frozen=True)
class MonitoredRollout:
    """A stored rollout, replayed and monitored.

    Attributes:
        stored: The stored rollout.
        result: Robustness over time and its causes; None if the rollout cannot be shown.
        frames: Vehicles, observations and plans of each step; empty without vehicles.
        problem: Reason why it cannot be shown; otherwise empty.
    """

    stored: StoredRollout
    result: MonitoringResult | None
    frames: tuple[Frame, ...] = ()
    problem: str = ""


def select_rollouts(
    name: str, failures: Failures | None, sample: RolloutSample | None
) -> list[StoredRollout]:
    """Return the worst and the most likely stored failure, or the rollout nearest to a failure."""
    if failures is None or not len(failures.robustness):
        if sample is None or np.isnan(sample.worst.robustness):
            return []
        noise, robustness = sample.worst.noise, sample.worst.robustness
        return [StoredRollout("Nearest to a failure", name, noise, robustness, False)]
    worst = int(np.argmin(failures.robustness))
    likely = int(np.argmin(np.square(failures.noise).sum(axis=(1, 2))))
    titles = {worst: "Worst failure"}
    titles[likely] = "Worst and most likely failure" if likely == worst else "Most likely failure"
    return [
        StoredRollout(title, name, failures.noise[k], float(failures.robustness[k]), True)
        for k, title in titles.items()
    ]


def replay_stored(scenario: LoadedScenario, stored: Sequence[StoredRollout]) -> list[MonitoredRollout]:
    """Replay rollouts in one batch and monitor them."""
    if not stored:
        return []
    if len({one.tape.shape for one in stored}) > 1:
        raise UsageError("the stored tapes have different shapes", "run the scenario again")
    missing = [one.specification for one in stored if one.specification not in scenario.specifications]
    if missing:
        raise UsageError(f"its scenario.yaml has no specification {missing[0]!r}", "run the scenario again")
    problem = scenario.problem(scenario.specifications)
    rollouts = replay_tapes(problem, np.stack([one.tape for one in stored]))
    return [_monitor(scenario, one, rollout) for one, rollout in zip(stored, rollouts, strict=True)]


def _monitor(scenario: LoadedScenario, stored: StoredRollout, rollout: ReplayedRollout) -> MonitoredRollout:
    if rollout.error is not None:
        text = f"the rollout ended with an error after {len(rollout.states)} samples"
        return MonitoredRollout(stored, None, problem=text)
    recording = record_rollout(scenario, rollout, scenario.name)
    specification = scenario.stack.specifications[stored.specification]
    try:
        result = monitor_recording(stored.specification, specification, recording)
    except AvrareError as error:
        return MonitoredRollout(stored, None, problem=error.message)
    return MonitoredRollout(stored, result, tuple(extract_frames(scenario, rollout)))
