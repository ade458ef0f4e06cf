"""Where the first search begins: a deterministic set of smooth drives, two for each lane of the ego.

The programme has several local minima (stay behind, change lane), and the solver finds the one it starts
near. The set is solved in this order, and the cheapest plan is kept: first lane at constant speed, first lane
braking, second lane at constant speed, and so on. Later steps follow the chosen minimum by starting from the
last plan.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

BRAKING = (0.0, 3.0)
"""Decelerations of the drives towards one lane [m/s^2]."""
CHANGE = 0.75
"""Part of the horizon after which a drive has arrived in its lane."""


def start_drives(start: Floats, centres: tuple[float, ...], steps: int, dt: float) -> tuple[Floats, Floats]:
    """States and inputs of the drives from which the first plan is searched.

    Args:
        start: (N, 4) x, y, speed, heading now.
        centres: y of the C lanes [m].
        steps: H.
        dt: Step [s].

    Returns:
        (N, 2 C, H + 1, 4) x, y, speed, heading and (N, 2 C, H, 2) acceleration, turn rate. The drives are
        smooth, but not exact solutions of the model.
    """
    lanes = np.repeat(np.array(centres), len(BRAKING))[:, None]
    braking = np.tile(np.array(BRAKING), len(centres))[:, None]
    time = np.arange(steps + 1) * dt
    x0, y0, v0, h0 = (start[:, i, None, None] for i in range(4))
    speed = np.where(v0 > 0.0, np.maximum(v0 - braking * time, 0.0), v0)
    part = np.clip(time / (CHANGE * steps * dt), 0.0, 1.0)
    y = y0 + (lanes - y0) * part**2 * (3.0 - 2.0 * part)
    x = np.broadcast_to(x0, y.shape).copy()
    x[..., 1:] += np.cumsum(speed[..., :-1] * dt, axis=-1)
    heading = np.zeros_like(y)
    heading[..., :-1] = np.arctan2(np.diff(y), np.maximum(np.diff(x), dt))
    heading[..., 0] = h0[..., 0]
    inputs = np.stack([np.diff(speed), np.diff(heading)], axis=-1) / dt
    return np.stack([x, y, speed, heading], axis=-1), inputs
