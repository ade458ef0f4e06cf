"""Speed of a vehicle that reaches its target when another one reaches its own."""

from __future__ import annotations

import numpy as np

from avrare.protocols import Floats

_STILL = 1e-3
"""Speed below which a vehicle stands [m/s]."""


def synchronize_speed(
    now: Floats,
    pace: Floats,
    way: Floats,
    master_way: Floats,
    final: Floats | None,
    steady: Floats,
    dt: float,
) -> Floats:
    """Return the speed (N,) of the next step.

    Args:
        now: Own speed [m/s].
        pace: Speed of the other [m/s].
        way: Own way left [m].
        master_way: The other's way left [m].
        final: Own speed at the target; None: any.
        steady: Way before the target on which that speed is held [m].
        dt: Step [s].
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        left = master_way / pace
        if final is None:
            return np.where(pace < _STILL, 0.0, np.maximum(way / left, 0.0))
        holds = (way <= steady) | (left <= steady / final)
        way, left = way - steady, left - steady / final
        mean = way / left
        # From rest: wait, then one acceleration to the final speed; later a straight line to it.
        line = np.clip(2.0 * mean - final, 0.0, None)
        waits = (now < _STILL) & (left > 2.0 * way / final)
        resting = np.where(waits, 0.0, np.maximum(line, np.minimum(final, dt * final / np.maximum(left, dt))))
        moving = _apex_speed(now, final, way, left, dt)
        value = np.where(now < _STILL, resting, moving)
        value = np.where(holds, final, value)
    return np.where(pace < _STILL, 0.0, value)


def _apex_speed(now: Floats, final: Floats, way: Floats, left: Floats, dt: float) -> Floats:
    # Two equal and opposite accelerations, whose ways add to the way left in the time left.
    mean = way / left
    on_line = np.abs(2.0 * mean - (now + final)) < 0.02 * (1.0 + np.abs(final))
    line = now + (final - now) * dt / np.maximum(left, dt)
    # With x the share of the time before the apex v: (v - now) / x = (v - final) / (1 - x).
    gap, excess = final - now, 2.0 * mean - now - final
    root = np.sqrt(excess**2 + gap**2)
    apex = 0.5 * (now + final + excess + np.where(excess >= 0.0, root, -root))
    share = np.where(2.0 * apex - now - final == 0.0, 0.5, (apex - now) / (2.0 * apex - now - final))
    rate = (apex - now) / np.maximum(share * left, dt)
    return np.maximum(np.where(on_line, line, now + rate * dt), 0.0)
