"""Frames of a replayed rollout: what was true, seen, predicted and planned at each step."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from avrare.protocols import Floats, HasPlan, find_ability
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
    horizon = loop.controller.horizon if loop.controller is not None else 0
    frames = []
    for t, state in enumerate(rollout.states):
        prediction = loop.tracker.predict(state.track, horizon) if loop.tracker is not None else None
        planning = find_ability(state.memory, HasPlan)
        plan = planning.plan_states[0] if planning is not None and t > 0 else None
        frames.append(Frame(t, state.world, state.observation, prediction, plan))
    return frames
