"""Sample traffic on a short road, as input for parts made for driving."""

from __future__ import annotations

import numpy as np

from avrare.driving import Road, Scene, Vehicles
from avrare.driving.values import World
from avrare.protocols import Floats, Signals

_DT = 0.2
"""Time step [s]."""


def scene() -> Scene:
    """Return a scene of three lanes and three cars."""
    names = ("ahead", "left", "behind")
    return Scene(
        dt=_DT,
        road=Road(lane_centres=(-1.75, 1.75, 5.25), lane_width=3.5),
        ego_length=4.5,
        ego_width=1.8,
        names=names,
        lengths=np.full(len(names), 4.5),
        widths=np.full(len(names), 1.8),
        moving=np.ones(len(names), dtype=bool),
    )


def world(numbers: Floats, step: int) -> World:
    """Return the traffic at a step, a little different in each row.

    Args:
        numbers: Standard normal numbers (N, 4): ego and three others are shifted by as many half metres.
        step: Number of the step.
    """
    time = _DT * step
    shift = 0.5 * numbers
    x = np.array([45.0, 20.0, -10.0]) + np.array([18.0, 20.0, 19.0]) * time + shift[:, 1:]
    others = _vehicles(x, np.array([1.75, 5.25, 1.75]), np.array([18.0, 20.0, 19.0]))
    ego = _vehicles(20.0 * time + shift[:, 0], np.array(1.75), np.array(20.0))
    return World(np.full(len(numbers), step), ego, others, np.zeros(len(numbers)))


def signals(state: World) -> Signals:
    """Return the signals of a driving simulator in this state."""
    fields = ("x", "y", "heading", "speed", "acceleration")
    named = {f"ego_{name}": getattr(state.ego, name) for name in fields}
    named |= {f"others_{name}": getattr(state.others, name) for name in fields}
    distance = np.hypot(state.others.x - state.ego.x[:, None], state.others.y - state.ego.y[:, None]) - 4.5
    return {**named, "distance": distance, "gap": distance.min(axis=1)}


def _vehicles(x: Floats, y: Floats, speed: Floats) -> Vehicles:
    zeros = np.zeros_like(x)
    return Vehicles(x, zeros + y, zeros, zeros + speed, zeros)
