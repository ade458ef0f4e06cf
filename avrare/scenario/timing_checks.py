"""Static checks of a scenario's timing against the simulator's step and the length of a drive."""

from __future__ import annotations

from avrare.scenario.timing import Timing
from avrare.scenario.validation import Mistake
from avrare.scenario.value_positions import Node

_CONSEQUENCES = {
    "sensor_period": "it has a single frame",
    "tracker_period": "the tracker is updated once",
    "planner_period": "it has a single plan",
    "perception_latency": "none of its frames is ever read",
    "planning_latency": "none of its plans takes effect",
    "actuation_delay": "none of its commands takes effect",
}
"""Effect of a time that is as long as the drive."""


def check_timing(
    timing: Timing | None, node: Node | None, dt: float | None, steps: int | None
) -> tuple[list[Mistake], list[Mistake]]:
    """Return errors and warnings of the block ``timing``; ``dt`` [s] and ``steps`` may be unknown."""
    if timing is None or node is None or dt is None:
        return [], []

    def place(name: str, text: str, hint: str | None = None) -> Mistake:
        written = node.child(name)
        return Mistake(node.name_mark if written is None else written.mark, ("timing", name), text, hint)

    errors = [place(name, error.message, error.hint) for name, error in timing.find_faults(dt).items()]
    duration, written = (steps or 0) * dt, timing.model_dump(exclude_none=True)
    late = [name for name in _CONSEQUENCES if written.get(name, 0.0) >= duration > 0.0]
    warnings = [
        place(
            name, f"{written[name]:g} s is not shorter than the drive, {duration:g} s: {_CONSEQUENCES[name]}"
        )
        for name in late
    ]
    return errors, warnings
