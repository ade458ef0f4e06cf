"""The others around the ego, from a prediction; and how the ego stays in its lane."""

from __future__ import annotations

import numpy as np

from avrare.base.errors import UsageError
from avrare.driving import Prediction, Road, Scene, Vehicles
from avrare.protocols import Bools, Floats
from avrare_reference_drivers.drivers import Situation

_LATERAL_GAIN, _HEADING_GAIN = 0.3, 1.5
"""Of the steering towards a lane: course to its centre per metre and second, turn rate per course [1/s]."""


def find_situation(controller: str, scene: Scene, ego: Vehicles, prediction: Prediction | None) -> Situation:
    """Return the situation (N, V) of the ego and each other vehicle.

    Args:
        controller: Name for errors.
        scene: Sizes and step.
        ego: Current state, fields (N,).
        prediction: The others now and a step later.

    Raises:
        UsageError: The prediction is missing.
    """
    if prediction is None:
        raise UsageError(f"the controller {controller} needs predictions", "name a tracker in the scenario")
    missing = np.isposinf(prediction.x[:, :, 0])
    # a vehicle that does not exist is 1,000 km behind the ego
    x = np.where(missing[:, :, None], ego.x[:, None, None] - 1e6, prediction.x[:, :, :2])
    y = np.where(missing[:, :, None], ego.y[:, None, None], prediction.y[:, :, :2])
    speed = ego.speed[:, None] * np.ones_like(x[:, :, 0])
    ahead, across = x[:, :, 0] - ego.x[:, None], y[:, :, 0] - ego.y[:, None]
    velocity = np.diff(y, axis=2)[:, :, 0] / scene.dt
    return Situation(
        speed=speed,
        other_speed=np.diff(x, axis=2)[:, :, 0] / scene.dt,
        ahead=ahead,
        gap=np.abs(ahead) - 0.5 * (scene.ego_length + scene.lengths),
        side_gap=np.abs(across) - 0.5 * (scene.ego_width + scene.widths),
        approach=-velocity * np.sign(across),
        acceleration=ego.acceleration[:, None] * np.ones_like(ahead),
    )


def find_leader(seen: Situation, margin: float) -> tuple[Floats, Floats, Bools]:
    """Return gap, speed and existence (N,) of the nearest vehicle ahead within ``margin`` aside."""
    leads = (seen.ahead >= 0.0) & (seen.side_gap < margin)
    gaps = np.where(leads, seen.gap, np.inf)
    if not gaps.shape[1]:
        zeros = np.zeros(len(gaps))
        return zeros, zeros, np.zeros(len(gaps), dtype=np.bool_)
    nearest = gaps.argmin(axis=1)[:, None]
    gap = np.take_along_axis(gaps, nearest, axis=1)[:, 0]
    speed = np.take_along_axis(seen.other_speed, nearest, axis=1)[:, 0]
    exists = np.asarray(leads.any(axis=1))
    return np.where(exists, gap, 0.0), np.where(exists, speed, 0.0), exists


def steer_in_lane(road: Road, ego: Vehicles, y_goal: float | None) -> Floats:
    """Return the yaw rate (N,) towards a lateral position, or the centre of the nearest lane [rad/s]."""
    if y_goal is None:
        centres = np.array(road.lane_centres)
        goal = centres[np.abs(ego.y[:, None] - centres).argmin(axis=1)]
    else:
        goal = np.full_like(ego.y, y_goal)
    lateral = np.clip(_LATERAL_GAIN * (goal - ego.y), -1.0, 1.0)
    course = np.arctan2(lateral, np.maximum(ego.speed, 1.0))
    turn = _HEADING_GAIN * (course - ego.heading)
    if road.line is None:
        return np.asarray(turn)
    curvature = road.line.curvature(ego.x)
    return np.asarray(turn + ego.speed * curvature / (1.0 - curvature * ego.y))
