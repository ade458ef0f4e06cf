"""Distances that vehicles keep to each other."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from avrare.driving import Vehicles
from avrare.protocols import Floats
from avrare_openscenario.story import Gap

if TYPE_CHECKING:
    from avrare_openscenario.scenario_file import Body

_STIFFNESS = 0.4
"""Spring of a distance that is kept with a limited acceleration, over that limit [1/m]."""


def place_gap(gap: Gap, bodies: Sequence[Body], table: Floats, points: Vehicles) -> Floats:
    """Return the station (N,), or offset, at which a point of reference has its distance."""
    value = table[:, gap.value]
    if gap.timed:
        value = value * np.abs(points.speed[:, gap.other])
    place = points.y if gap.across else points.x
    mine, theirs = place[:, gap.actor], place[:, gap.other]
    along = np.sign(np.cos(points.heading[:, gap.other]))
    side = gap.side * along if gap.side else np.where(mine >= theirs, 1.0, -1.0)
    if not gap.free:
        return np.asarray(theirs + side * value)
    body, other = bodies[gap.actor], bodies[gap.other]
    size = body.width + other.width if gap.across else body.length + other.length
    centre = theirs + side * (value + 0.5 * size)
    if gap.across:
        return np.asarray(centre)
    mine_along = np.sign(np.cos(points.heading[:, gap.actor]))
    return np.asarray(centre - mine_along * body.ahead + along * other.ahead)


def close_gap(gap: Gap, bodies: Sequence[Body], table: Floats, points: Vehicles, dt: float) -> Floats:
    """Return the speed (N,) of the next step of a vehicle that closes its distance."""
    lag = place_gap(gap, bodies, table, points) - points.x[:, gap.actor]
    lag = lag * np.sign(np.cos(points.heading[:, gap.actor]))
    now, theirs = points.speed[:, gap.actor], points.speed[:, gap.other]
    if gap.acceleration is None:
        return np.asarray(theirs + lag / dt)
    most = table[:, gap.acceleration]
    stiffness = _STIFFNESS * most
    demand = np.clip(stiffness * lag + 2.0 * np.sqrt(stiffness) * (theirs - now), -most, most)
    fastest = np.inf if gap.speed is None else table[:, gap.speed]
    return np.clip(now + dt * demand, 0.0, fastest)
