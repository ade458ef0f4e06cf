"""The rollouts that a report shows, driven again from their noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from avrare.build.scenario import BuildableScenario
from avrare.errors import AvrareError, UsageError
from avrare.estimation.result import Failures
from avrare.protocols import Floats
from avrare.record.rollouts import Sample
from avrare.record.trace import Recording
from avrare.record.trace_score import Score, score
from avrare.report.picture import Frame, replay_frames


@dataclass(frozen=True)
class Shown:
    """A stored rollout that a report shows.

    Attributes:
        title: What makes it worth showing.
        specification: Whose it is.
        tape: (steps + 1, noise_size).
        robustness: As it was stored.
        failed: It is a failure.
    """

    title: str
    specification: str
    tape: Floats
    robustness: float
    failed: bool

    @property
    def norm(self) -> float:
        """Of the noise: the smaller, the likelier."""
        return float(np.sqrt(np.square(self.tape).sum()))


@dataclass(frozen=True)
class Drive:
    """A rollout driven again.

    Attributes:
        shown: What was stored.
        score: Its robustness over time and what decided it; None where it broke down.
        frames: The moments, with what was perceived and planned; empty without vehicles.
        trouble: Why it cannot be shown; empty: it can.
    """

    shown: Shown
    score: Score | None
    frames: tuple[Frame, ...] = ()
    trouble: str = ""

    @property
    def differs(self) -> bool:
        """Whether it came out with another robustness than it was stored with."""
        return self.score is not None and self.score.robustness != self.shown.robustness


def select(name: str, failures: Failures | None, sample: Sample | None) -> list[Shown]:
    """The worst and the most likely of the stored failures, or the rollout that came nearest to one."""
    if failures is None or not len(failures.robustness):
        if sample is None or np.isnan(sample.worst.robustness):
            return []
        return [Shown("Nearest to a failure", name, sample.worst.noise, sample.worst.robustness, False)]
    worst = int(np.argmin(failures.robustness))
    likely = int(np.argmin(np.square(failures.noise).sum(axis=(1, 2))))
    titles = {worst: "Worst failure"}
    titles[likely] = "Worst and most likely failure" if likely == worst else "Most likely failure"
    return [
        Shown(title, name, failures.noise[k], float(failures.robustness[k]), True)
        for k, title in titles.items()
    ]


def drive_again(scenario: BuildableScenario, shown: Sequence[Shown]) -> list[Drive]:
    """Drive rollouts again, all in one batch.

    Raises:
        AvrareError: The scenario cannot be built, or its tapes do not fit it.
    """
    if not shown:
        return []
    if len({one.tape.shape for one in shown}) > 1:
        raise UsageError("the stored tapes have several shapes", "run the scenario again")
    gone = [one.specification for one in shown if one.specification not in scenario.specifications]
    if gone:
        raise UsageError(f"its scenario.yaml has no specification {gone[0]!r}", "run the scenario again")
    drives = replay_frames(scenario, np.stack([one.tape for one in shown]))
    return [_drive(scenario, one, *found) for one, found in zip(shown, drives, strict=True)]


def _drive(
    scenario: BuildableScenario, shown: Shown, frames: list[Frame], signals: list[dict[str, Any]]
) -> Drive:
    stack = scenario.stack
    if len(signals) <= scenario.steps:
        return Drive(shown, None, trouble=f"it broke down after {len(signals)} samples")
    joined = {key: np.concatenate([sample[key] for sample in signals]) for key in signals[0]}
    names = stack.scene.names if stack.scene is not None else ()
    dt = float(stack.loop.simulator.dt)
    recording = Recording(scenario.name, dt, 0.0, joined, stack.scene, names)
    try:
        scored = score(shown.specification, stack.specifications[shown.specification], recording)
    except AvrareError as error:
        return Drive(shown, None, trouble=error.message)
    return Drive(shown, scored, tuple(frames))
