"""Planning on bent roads: the plan is one of the straight road, in lengths along the ego's own offset.

With x the length along the curve at the ego's offset y, heading h against the road and turn rate w beyond the
road's own, x' = v cos(h), y' = v sin(h), h' = w hold on any road while the ego stays at y; a lane change by D
in a bend of radius R errs by D / R in x'. So the programme stays what it is, and the road's curvature enters
where the other vehicles are, and the commands.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from avrare.driving import Vehicles
from avrare.driving.reference_line import ReferenceLine
from avrare.protocols import Floats


def measure_along_ego_offset(line: ReferenceLine, ego: Vehicles, x: Floats) -> Floats:
    """Return stations ``x`` (N, V, H + 1) as the ego's station plus the length along its offset [m]."""
    shape = (-1, *[1] * (x.ndim - 1))
    turned = line.heading(x) - line.heading(ego.x).reshape(shape)
    return np.asarray(x - ego.y.reshape(shape) * turned)


def road_slip_angle(line: ReferenceLine, ego: Vehicles, wheelbase: float) -> Floats:
    """Return the angle (N,) from the body to the course of its middle on a circle along the road [rad].

    Half-way between the axles of a single-track vehicle sin(β) = L / 2R (Rajamani, Vehicle Dynamics and
    Control, 2.2).
    """
    curvature = line.curvature(ego.x)
    return np.asarray(np.arcsin(np.clip(0.5 * wheelbase * curvature / (1.0 - curvature * ego.y), -1.0, 1.0)))


def road_yaw_rate(line: ReferenceLine, ego: Vehicles, dt: float) -> Floats:
    """Return the yaw rate (N,) that follows the road over the next step [rad/s]."""
    pace = ego.speed * np.cos(ego.heading) / (1.0 - line.curvature(ego.x) * ego.y)
    return np.asarray((line.heading(ego.x + pace * dt) - line.heading(ego.x)) / dt)


class BendSpeed:
    """Speed along a road from which the ego can slow down in time for every bend ahead.

    Args:
        line: The road's line.
        offsets: y of the lanes that the ego may drive in; the tightest decides [m].
        lateral: Lateral acceleration that no bend is to demand [m/s^2].
        braking: Deceleration ahead of bends [m/s^2].
    """

    def __init__(self, line: ReferenceLine, offsets: Sequence[float], lateral: float, braking: float) -> None:
        spacing = 0.5  # [m]
        self._stations = s = np.arange(0.0, line.length + spacing, spacing)
        curvature = line.curvature(s)
        tightest = np.max([np.abs(curvature / (1.0 - curvature * y)) for y in offsets], axis=0)
        # the square of the speed falls by 2 b in each metre
        # a smaller curvature [1/m] counts as straight
        square = lateral / np.maximum(tightest, 1e-6) + 2.0 * braking * s
        self._square = np.minimum.accumulate(square[::-1])[::-1] - 2.0 * braking * s
        self._braking = braking

    def limit(self, ego: Vehicles) -> Floats:
        """Return the speed (N,) at the ego's station [m/s]."""
        ahead = 2.0 * self._braking * np.maximum(-ego.x, 0.0)  # of a road that begins further on
        return np.asarray(np.sqrt(np.interp(ego.x, self._stations, self._square) + ahead))
