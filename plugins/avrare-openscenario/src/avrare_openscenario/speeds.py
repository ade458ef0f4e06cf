"""Speeds of vehicles that follow a profile, keep a distance, or meet another one at their targets."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from avrare.driving import Vehicles
from avrare.protocols import Bools, Floats
from avrare_openscenario.story import Gap, SpeedProfile

if TYPE_CHECKING:
    from avrare_openscenario.scenario_file import Body
    from avrare_openscenario.trajectories import Pose

_STIFFNESS = 0.4
"""Spring of a distance that is kept with a limited acceleration, over that limit [1/m]."""
_NEAR, _NEAR_ASIDE = 0.1, 0.01
"""Most difference from a distance along and across the road that is reached [m]."""
_NARROWEST = 0.5
"""Least radius of the turns to a line beside another vehicle [m]."""
_STILL = 1e-3
"""Speed below which a vehicle stands [m/s]."""


def follow_profile(
    profile: SpeedProfile, table: Floats, start: Floats, slope: Floats, clock: Floats
) -> tuple[Floats, Bools]:
    """Return the speed (N,) at a time since the begin, and whether the last one is reached.

    Each speed is approached linearly, in its time or as fast as is allowed. Around each change of the
    acceleration the jerk is constant; the first one begins at the start, so that the line comes later.
    """
    change = np.diff(np.column_stack([start, table[:, list(profile.speeds)]]), axis=1)
    limits, sign = table[:, list(profile.limits)], np.where(change >= 0.0, 1.0, -1.0)
    most, jerk = (np.where(sign > 0.0, limits[:, [k]], limits[:, [k + 1]]) for k in (0, 2))
    with np.errstate(divide="ignore", invalid="ignore"):
        times = np.maximum(table[:, list(profile.durations)], np.abs(change) / most)
        if change.shape[1] == 1:  # the time includes the jerks
            lag, late = (
                0.5 * sign * (1.0 / limits[:, 2:3] + 1.0 / limits[:, 3:4]),
                slope[:, None] / (sign * jerk),
            )
            longer, wanted = times + late, change + 0.5 * late * slope[:, None]
            room = longer**2 - 4.0 * lag * wanted
            rate = 2.0 * wanted / (longer + np.sqrt(room))
            rate = np.where(room < 0.0, sign * np.sqrt(wanted / lag), rate)
            times = change / np.clip(rate, -most, most)
        slopes, times = np.nan_to_num(change / times), np.nan_to_num(times)
        steps = np.diff(np.column_stack([slope, slopes, np.zeros(len(slope))]), axis=1)
        reach = 0.5 * np.abs(steps) / np.where(steps >= 0.0, limits[:, 2:3], limits[:, 3:4])
        kinks = np.column_stack([reach[:, 0], np.cumsum(times, axis=1)])
        kinks[:, 1] -= np.nan_to_num(steps[:, 0] * reach[:, 0] / steps[:, 1])
        since = clock[:, None] - kinks
        bent = np.nan_to_num(np.maximum(reach - np.abs(since), 0.0) ** 2 / (4.0 * reach))
    value = start + slope * clock + (steps * (np.maximum(since, 0.0) + bent)).sum(axis=1)
    return value, clock >= kinks[:, -1] + reach[:, -1] - 1e-6


def place_gap(gap: Gap, bodies: Sequence[Body], table: Floats, points: Vehicles) -> Floats:
    """Return the station (N,), or offset, at which a point of reference has its distance."""
    value = table[:, gap.value]
    if gap.timed:
        value = value * np.abs(points.speed[:, gap.other])
    place = points.y if gap.across else points.x
    here, there = place[:, gap.actor], place[:, gap.other]
    along = np.sign(np.cos(points.heading[:, gap.other]))
    side = gap.side * along if gap.side else np.where(here >= there, 1.0, -1.0)
    if not gap.free:
        return np.asarray(there + side * value)
    body, other = bodies[gap.actor], bodies[gap.other]
    size = body.width + other.width if gap.across else body.length + other.length
    centre = there + side * (value + 0.5 * size)
    if gap.across:
        return np.asarray(centre)
    mine_along = np.sign(np.cos(points.heading[:, gap.actor]))
    return np.asarray(centre - mine_along * body.ahead + along * other.ahead)


def close_gap(
    gap: Gap, bodies: Sequence[Body], table: Floats, points: Vehicles, dt: float
) -> tuple[Floats, Bools]:
    """Return the speed (N,) of the next step of a vehicle that closes its distance, and whether it has it."""
    lag = place_gap(gap, bodies, table, points) - points.x[:, gap.actor]
    lag = lag * np.sign(np.cos(points.heading[:, gap.actor]))
    now, theirs = points.speed[:, gap.actor], points.speed[:, gap.other]
    over = (np.abs(lag) < _NEAR) & (not gap.continuous)
    if gap.acceleration is None:
        return np.asarray(theirs + lag / dt), over
    fastest = np.inf if gap.speed is None else table[:, gap.speed]
    return np.clip(now + dt * _pull(lag, theirs - now, table[:, gap.acceleration]), 0.0, fastest), over


def close_aside(
    gap: Gap, table: Floats, lag: Floats, slip: Floats, speed: Floats, dt: float
) -> tuple[Floats, Bools]:
    """Return the speed (N,) across the road of the next step, and whether its distance is reached."""
    aside, over = lag / dt, np.abs(lag) < _NEAR_ASIDE
    most = np.abs(speed)
    if gap.acceleration is not None:
        aside = slip + dt * _pull(lag, -slip, table[:, gap.acceleration])
    elif gap.speed is not None:
        over = np.abs(lag) <= np.minimum(most, table[:, gap.speed]) * dt
    else:
        most = np.full_like(lag, np.inf)
    if gap.speed is not None:
        most = np.minimum(most, table[:, gap.speed])
    return np.clip(aside, -most, most), over & (not gap.continuous)


def _pull(lag: Floats, faster: Floats, most: Floats) -> Floats:
    # Acceleration of a critically damped spring, limited.
    stiffness = _STIFFNESS * most
    return np.clip(stiffness * lag + 2.0 * np.sqrt(stiffness) * faster, -most, most)


def steer_beside(
    gap: Gap, bodies: Sequence[Body], table: Floats, other: Pose, pose: Pose, speed: Floats, dt: float
) -> Pose:
    """Return the pose in the plane, one step later, of a vehicle that steers to a line beside another one."""
    aside = table[:, gap.value] + 0.5 * gap.free * (bodies[gap.actor].width + bodies[gap.other].width)
    aside = aside if gap.side >= 0 else -aside
    (x, y, heading), (other_x, other_y, along) = pose, other
    cos, sin, way = np.cos(along), np.sin(along), speed * dt
    lag = aside - (cos * (y - other_y) - sin * (x - other_x))
    if gap.acceleration is None:
        rest = np.maximum(np.abs(way) - np.abs(lag), 0.0)
        return x - sin * lag + cos * rest, y + cos * lag + sin * rest, along
    radius = np.maximum(1.5 * speed**2 / table[:, gap.acceleration], _NARROWEST)
    bend = np.abs(way) / radius
    share = 2.0 * np.maximum(np.arccos(np.clip(1.0 - np.abs(lag) / radius, 0.0, 1.0)), 0.5 * bend)
    share = np.clip((share - 0.5 * bend) / np.pi, 0.0, 1.0)
    share = np.where(np.abs(lag) < radius, share * share * (3.0 - 2.0 * share), 1.0)
    towards, align = (
        np.remainder(angle - heading + np.pi, 2.0 * np.pi) - np.pi
        for angle in (along + 0.5 * np.pi * np.sign(lag), along)
    )
    heading = heading + np.clip(share * towards + (1.0 - share) * align, -1.5 * bend, 1.5 * bend)
    return x + way * np.cos(heading), y + way * np.sin(heading), heading


def synchronize_speed(
    now: Floats,
    pace: Floats,
    way: Floats,
    master_way: Floats,
    final: Floats | None,
    steady: Floats,
    dt: float,
) -> Floats:
    """Return the speed (N,) of the next step, for both ways left [m] and the pace of the other [m/s]."""
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
