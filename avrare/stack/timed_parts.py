"""Parts of a stack with the latencies, periods and actuators of a scenario around them."""

from __future__ import annotations

from typing import NamedTuple

from avrare.base.errors import UsageError
from avrare.driving import Scene
from avrare.protocols import Controller, PerceptionErrorModel, Tracker
from avrare.scenario.timing import Actuators, Timing
from avrare.stack.clock import Clock
from avrare.stack.timed_controller import TimedController
from avrare.stack.timed_perception import ExactPerception, PacedTracker, TimedPerception


class Parts(NamedTuple):
    """Parts of a stack, as far as there are any."""

    perception: PerceptionErrorModel | None
    tracker: Tracker | None
    controller: Controller | None


def time_parts(
    timing: Timing, actuators: Actuators, clock: Clock, scene: Scene | None, parts: Parts
) -> Parts:
    """Return the parts with the delays that ``timing`` and ``actuators`` ask for.

    Raises:
        UsageError: An option is about a part that the scenario has not.
    """
    of_frames = ("sensor_period", "tracker_period", "perception_latency", "perception_jitter", "lost_frames")
    of_cycles = ("planner_period", "planning_latency", "missed_cycles", "actuation_delay", "compensated")
    frames, cycles = ([name for name in names if getattr(timing, name)] for names in (of_frames, of_cycles))
    if frames and parts.tracker is None:
        raise UsageError(f"{frames[0]} needs a tracker", "add a `tracker:` block, or remove the option")
    controlled = bool(cycles) or actuators != Actuators()
    if controlled and parts.controller is None:
        name = cycles[0] if cycles else "actuators"
        raise UsageError(f"{name}: needs a controller", "add a `controller:` block, or remove the option")
    perception, tracker, controller = parts
    if frames:
        perception = TimedPerception(perception or ExactPerception(), timing, clock)
    if tracker is not None and (clock.tracker, clock.planner) != (1, 1):
        tracker = PacedTracker(tracker, clock)
    if controlled and controller is not None:
        controller = TimedController(controller, timing, clock, actuators, scene)
    return Parts(perception, tracker, controller)
