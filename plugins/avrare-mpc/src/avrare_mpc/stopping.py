"""Stopping: the acceleration with which the ego can always stop behind what its plan does not pass.

A plan has a price for every clearance that it lacks, and ends after a few seconds. For a road that it cannot
pass both are too little: braking is dearer than the price, and the stopping distance longer than the plan. So
the acceleration is bounded from outside: behind a vehicle in its way the ego can brake at a constant rate
until both stand, if that vehicle does the same. Where it is too late for that, it brakes as much as it needs.
"""

from __future__ import annotations

import numpy as np

from avrare.driving import Scene
from avrare.protocols import Bools, Floats


def stopping_acceleration(
    states: Floats, others: tuple[Floats, Floats], scene: Scene, braking: float
) -> Floats:
    """Return the greatest acceleration (N,) of the next step after which the ego can still stop.

    It stops behind what is in its way; inf where nothing is.

    Args:
        states: (N, H + 1, 4) x, y, speed, heading of its plan, which begins now.
        others: Predicted x and y, each (N, V, H + 1) [m].
        scene: Sizes of the vehicles and the step.
        braking: Deceleration of the ego and of those in front [m/s^2].
    """
    x, y = others
    if not x.shape[1]:
        return np.full(len(states), np.inf)
    lengths, widths = (np.asarray(sizes)[None, :, None] for sizes in (scene.lengths, scene.widths))
    rear = x - 0.5 * (lengths + scene.ego_length) - 1.0  # the ego stands 1 m behind a vehicle in the way
    offsets = states[:, None, :, 1]
    aside = np.maximum(np.abs(offsets - y), np.abs(offsets - y[:, :, :1]))  # now and then
    overlaps = aside < 0.5 * (widths + scene.ego_width) + 0.3  # with 0.3 m of room to the side
    ahead = x[:, :, 0] > states[:, :1, 0]
    in_way = ahead & _at_passing(overlaps, states[:, None, :, 0] >= rear)

    speed = states[:, :1, 2]
    others_speed = np.maximum(x[:, :, 1] - x[:, :, 0], 0.0) / scene.dt
    others_way = others_speed**2 / (2.0 * braking)
    gap = np.maximum(rear[:, :, 0] - states[:, :1, 0], 0.0)
    next_gap = np.maximum(rear[:, :, 1] - states[:, :1, 0] - scene.dt * speed, 0.0)
    limit = np.sqrt(2.0 * braking * (next_gap + others_way))
    with np.errstate(divide="ignore", invalid="ignore"):
        needed = np.where(speed > 0.0, speed**2 / (2.0 * (gap + others_way)), 0.0)
    bound = np.maximum((limit - speed) / scene.dt, -np.maximum(needed, braking))
    return np.asarray(np.where(in_way, bound, np.inf).min(axis=1))


def _at_passing(holds: Bools, passes: Bools) -> Bools:
    """Return values (N, V) of (N, V, H + 1) at the first node that passes, or at the last node."""
    last = holds.shape[2] - 1
    node = np.where(passes.any(axis=2), passes.argmax(axis=2), last)
    return np.take_along_axis(holds, node[:, :, None], axis=2)[:, :, 0]
