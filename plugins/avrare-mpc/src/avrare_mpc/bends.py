"""Planning on bent roads: the plan is one of the straight road, in lengths along the ego's own offset.

With x the length along the curve at the ego's offset y, heading h against the road and turn rate w beyond the
road's own, x' = v cos(h), y' = v sin(h), h' = w hold on any road while the ego stays at y; a lane change by D
in a bend of radius R errs by D / R in x'. So the programme stays what it is, and the road's curvature enters
where the other vehicles are and what is commanded.
"""

from __future__ import annotations

import numpy as np

from avrare.driving import Vehicles
from avrare.driving.reference_line import ReferenceLine
from avrare.protocols import Floats


def beside_ego(line: ReferenceLine, ego: Vehicles, x: Floats) -> Floats:
    """Return stations ``x`` (N, V, H + 1) as the ego's own and the length from there at its offset [m]."""
    shape = (-1, *[1] * (x.ndim - 1))
    turned = line.heading(x) - line.heading(ego.x).reshape(shape)
    return np.asarray(x - ego.y.reshape(shape) * turned)


def slip_of_road(line: ReferenceLine, ego: Vehicles, wheelbase: float) -> Floats:
    """Return the angle (N,) from the body to the course of its middle on a circle along the road [rad].

    Half-way between the axles of a single-track vehicle sin(β) = L / 2R (Rajamani, Vehicle Dynamics and
    Control, 2.2).
    """
    curvature = line.curvature(ego.x)
    return np.asarray(np.arcsin(np.clip(0.5 * wheelbase * curvature / (1.0 - curvature * ego.y), -1.0, 1.0)))


def turn_of_road(line: ReferenceLine, ego: Vehicles, dt: float) -> Floats:
    """Return the yaw rate (N,) that follows the road over the next step [rad/s]."""
    pace = ego.speed * np.cos(ego.heading) / (1.0 - line.curvature(ego.x) * ego.y)
    return np.asarray((line.heading(ego.x + pace * dt) - line.heading(ego.x)) / dt)
