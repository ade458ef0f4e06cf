"""First violation of a failing rollout: when, and by which comparison of which vehicle."""

from __future__ import annotations

from dataclasses import dataclass

from avrare.analysis.failures.severity import Severity, measure_severity
from avrare.analysis.monitor.monitoring import monitor_recording
from avrare.base.errors import AvrareError
from avrare.results.recordings import Recording
from avrare.rollout.problem import Problem
from avrare.rollout.replay import ReplayedRollout


@dataclass(frozen=True)
class FirstViolation:
    """First violation; where it is unknown, ``sample`` is -1 and ``key`` empty.

    ``key`` is the comparison that decides, with the names of the vehicles, without numbers of samples, and
    the ego's part in an impact. ``severity`` is None without vehicles on lanes.
    """

    sample: int
    key: str
    vehicles: tuple[str, ...] = ()
    severity: Severity | None = None


def find_first_violation(problem: Problem, rollout: ReplayedRollout) -> FirstViolation:
    """Find the first violation of the first specification of ``problem`` in a replayed rollout."""
    scene, dt = problem.scene, problem.dt or 1.0
    names = () if scene is None else scene.names
    recording = Recording("a failure", dt, 0.0, rollout.signals, scene, names)
    unknown = FirstViolation(-1, "")
    try:
        monitoring = monitor_recording(problem.names[0], problem.monitors[0], recording)
    except AvrareError:  # a specification that cannot be explained: its failures are one cause
        return unknown
    decisive = monitoring.first or monitoring.worst
    if decisive is None:
        return unknown
    vehicles = tuple(decisive.vehicles.values())
    text = decisive.formula or problem.names[0]
    severity = measure_severity(monitoring)
    if severity is not None and severity.impact is not None:
        text = f"{text} (ego {severity.impact.role})"
    return FirstViolation(decisive.sample, text, vehicles, severity)
