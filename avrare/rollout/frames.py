"""Frames of a replayed rollout: what was true, seen, predicted and planned at each step."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from avrare.protocols import Floats
from avrare.rollout.problem import Problem
from avrare.rollout.replay import ReplayedRollout
from avrare.stack.closed_loop import ClosedLoop


@dataclass(frozen=True)
class Frame:
    """Step ``t`` of one rollout (N = 1) with the planned x and y (H + 1, >= 2); None: there is none."""

    t: int
    world: Any
    observation: Any = None
    prediction: Any = None
    plan: Floats | None = None


def extract_frames(problem: Problem, rollout: ReplayedRollout) -> list[Frame]:
    """Return the perceived, predicted and planned motion at every step; none without vehicles."""
    loop = problem.system
    if problem.scene is None or not isinstance(loop, ClosedLoop):
        return []
    return make_frames(loop, rollout)


def make_frames(loop: ClosedLoop, rollout: ReplayedRollout) -> list[Frame]:
    """Return the perceived, predicted and planned motion at every step of a loop with vehicles."""
    controller = loop.controller
    horizon = controller.horizon if controller is not None else 0
    frames = []
    for t, state in enumerate(rollout.states):
        prediction = loop.tracker.predict(state.track, horizon) if loop.tracker is not None else None
        plan = controller.plan(state.memory) if controller is not None and t > 0 else None
        frames.append(Frame(t, state.world, state.observation, prediction, None if plan is None else plan[0]))
    return frames
