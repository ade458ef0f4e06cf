"""The reference drivers: when each sees a danger, and how it brakes.

The formulas are those of UN R157 (annex 4, appendix 3, and 5.2.5.2), of Shalev-Shwartz, Shammah and Shashua
(RSS) and of Mattas et al. (FSM); docs/regulation.md has sources. All functions work on arrays.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from avrare.protocols import Bools, Floats

GRAVITY = 9.81
"""Standard gravity [m/s^2]."""
HARD_BRAKING = 0.774 * GRAVITY
"""Full braking of a human driver [m/s^2]."""
HARD_JERK = 12.65
"""Rise of a human driver's braking [m/s^3]."""
RELEASE_BRAKING = 0.4
"""Deceleration with the foot off the pedal [m/s^2]."""
CRITICAL_TTC = 2.0
"""Time to collision below which the careful driver brakes [s]."""

_LOWEST_BRAKING, _HIGHEST_BRAKING, _OTHERS_BRAKING = 4.0, 6.0, 7.0
_MARGIN = 2.0
_FSM_REACTION = 0.75
_RSS_REACTION, _RSS_ACCELERATION, _RSS_LATERAL, _RSS_MARGIN = 0.75, 3.0, 1.0, 0.3
_REG157_BRAKING, _REG157_REACTION, _REG157_GAP = 6.0, 0.35, 0.5


@dataclass(frozen=True)
class Situation:
    """Ego and one other vehicle.

    Attributes:
        speed: Of the ego [m/s].
        other_speed: Of the other, along the road [m/s].
        ahead: Distance of the centres along the road, positive where the other is ahead [m].
        gap: Free gap along the road, negative where they overlap [m].
        side_gap: Free gap across the road, negative where they overlap [m].
        approach: Speed of the other across the road towards the ego [m/s].
        acceleration: Of the ego over the last step [m/s^2].
    """

    speed: Floats
    other_speed: Floats
    ahead: Floats
    gap: Floats
    side_gap: Floats
    approach: Floats
    acceleration: Floats

    @property
    def closing(self) -> Floats:
        """Speed at which the gap shrinks [m/s]."""
        return self.speed - self.other_speed

    @property
    def ttc(self) -> Floats:
        """Absolute gap over absolute closing speed [s]; infinite at equal speeds."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.abs(self.gap / self.closing)


@dataclass(frozen=True)
class Driver:
    """One of the drivers.

    Attributes:
        demand: Braking (N,) that a situation demands [m/s^2]; 0: no danger.
        delay: Time from a danger to the first braking [s].
        braking: Bound of the braking [m/s^2].
        jerk: Rise of the braking [m/s^3].
        release: Deceleration during the delay [m/s^2].
    """

    demand: Callable[[Situation], Floats]
    delay: float
    braking: float = HARD_BRAKING
    jerk: float = HARD_JERK
    release: float = 0.0


@dataclass(frozen=True)
class Reaction:
    """Progress of each driver's reaction.

    Attributes:
        delay: Time until it may brake [s].
        braking: Braking of its last danger [m/s^2].
    """

    delay: Floats
    braking: Floats

    @staticmethod
    def start(driver: Driver, n: int) -> Reaction:
        """Return the state of ``n`` drivers that have seen no danger."""
        return Reaction(np.full(n, driver.delay), np.zeros(n))

    def advance(self, driver: Driver, demand: Floats, dt: float) -> tuple[Floats, Reaction]:
        """Return the braking over the next step [m/s^2], 0 without a danger, and the state after it.

        Args:
            driver: The driver.
            demand: (N,) braking that the situation demands [m/s^2].
            dt: Time step [s].
        """
        danger = demand > 0.0
        waiting = danger & (self.delay > 0.0)
        rising = np.minimum(np.minimum(self.braking + driver.jerk * dt, driver.braking), demand)
        braking = np.where(waiting, driver.release, np.where(danger, rising, self.braking))
        later = Reaction(np.where(waiting, self.delay - dt, self.delay), braking)
        return np.where(danger, braking, 0.0), later


def _demand_careful(seen: Situation, side_gap: float) -> Floats:
    near = (seen.ahead >= 0.0) & ~(seen.side_gap > side_gap) & ~(seen.ttc > CRITICAL_TTC)
    return np.where(near, HARD_BRAKING, 0.0)


def demand_cc(seen: Situation) -> Floats:
    """Return the braking of the competent and careful human driver, who acts on overlap across."""
    return _demand_careful(seen, 0.0)


def demand_cc_lane(seen: Situation) -> Floats:
    """Return the braking of the same driver, who knows where the lanes are."""
    # free gap across at which who knows the lanes sees a cut-in, of cars 1.9 m wide in lanes of 3.5 m [m]
    gap = 0.505
    return _demand_careful(seen, gap)


def demand_reg157(seen: Situation) -> Floats:
    """Return the braking of the system that meets R157 5.2.5.2 and no more."""
    step = 0.1
    limit = seen.closing / (2.0 * _REG157_BRAKING) + _REG157_REACTION + step
    near = (seen.ahead >= 0.0) & ~(seen.side_gap > _REG157_GAP) & ~(seen.ttc > limit)
    return np.where(near, _REG157_BRAKING, 0.0)


def rss_distance(speed: Floats, other_speed: Floats) -> Floats:
    """Return the safe distance along the road of RSS [m]."""
    later = speed + _RSS_REACTION * _RSS_ACCELERATION
    way = speed * _RSS_REACTION + _RSS_ACCELERATION * _RSS_REACTION**2 / 2.0
    safe_braking = 6.0
    return way + later**2 / (2.0 * safe_braking) - other_speed**2 / (2.0 * safe_braking)


def demand_rss(seen: Situation) -> Floats:
    """Return the braking of responsibility-sensitive safety, where both distances are too small."""
    across = np.abs(seen.approach)
    later = across + _RSS_LATERAL * _RSS_REACTION
    side = _RSS_MARGIN + (across + later) * _RSS_REACTION / 2.0 + later**2 / (2.0 * _RSS_LATERAL)
    near = (seen.ahead >= 0.0) & (seen.gap < rss_distance(seen.speed, seen.other_speed))
    return np.where(near & (seen.side_gap < side), HARD_BRAKING, 0.0)


def following_distance(speed: Floats) -> Floats:
    """Return the least distance of R157 5.2.3.3 [m]; its time rises from 1 s by 0.1 s for each 10 km/h."""
    kmh = 3.6 * speed
    time = np.interp(kmh, [7.2, 10.0], [1.0, 1.1]) + np.maximum(kmh - 10.0, 0.0) / 100.0
    least_distance = 2.0
    return np.maximum(speed * time, least_distance)


def fsm_distance(speed: Floats, other_speed: Floats) -> Floats:
    """Return the distance along the road at which the FSM driver sees no danger [m]."""
    stop = speed**2 / (2.0 * _LOWEST_BRAKING) - other_speed**2 / (2.0 * _OTHERS_BRAKING)
    return speed * _FSM_REACTION + stop + 2.0 * _MARGIN


def demand_fsm(seen: Situation) -> Floats:
    """Return the braking of the fuzzy safety model: gentle ahead of a danger, up to 6 m/s^2 in it."""
    proactive, critical = _proactive(seen), _critical(seen)
    span = _HIGHEST_BRAKING - _LOWEST_BRAKING
    demand = np.where(critical > 0.0, critical * span + _LOWEST_BRAKING, proactive * _LOWEST_BRAKING)
    return np.where((seen.ahead >= 0.0) & _arrives_in_front(seen), demand, 0.0)


def _arrives_in_front(seen: Situation) -> Bools:
    # the other is beside the ego before the ego has passed it
    with np.errstate(divide="ignore", invalid="ignore"):
        across = seen.side_gap / seen.approach
        along = (2.0 * np.abs(seen.ahead) - seen.gap) / seen.closing
        late = across > along + 0.1
    return ~(seen.side_gap > 0.0) | ((seen.approach > 0.0) & ~late)


def _share(gap: Floats, safe: Floats, unsafe: Floats) -> Floats:
    # 0 from ``safe`` on, 1 below ``unsafe``, linear between
    with np.errstate(divide="ignore", invalid="ignore"):
        between = (gap - safe) / (unsafe - safe)
    return np.where(gap >= safe, 0.0, np.where(gap <= unsafe, 1.0, between))


def _proactive(seen: Situation) -> Floats:
    u, w = seen.speed, seen.other_speed
    stop = u * _FSM_REACTION - w**2 / (2.0 * _OTHERS_BRAKING)
    safe = stop + u**2 / (2.0 * _LOWEST_BRAKING) + _MARGIN
    return _share(seen.gap - _MARGIN, safe, stop + u**2 / (2.0 * _HIGHEST_BRAKING))


def _critical(seen: Situation) -> Floats:
    u, w = seen.speed, seen.other_speed
    slowing = np.maximum(seen.acceleration, -_LOWEST_BRAKING)
    later = u + _FSM_REACTION * slowing
    way = (u + slowing * _FSM_REACTION / 2.0 - w) * _FSM_REACTION
    rest = (later - w) ** 2 / 2.0
    reacting = _share(seen.gap, way + rest / _LOWEST_BRAKING, way + rest / _HIGHEST_BRAKING)
    with np.errstate(divide="ignore", invalid="ignore"):
        meets = seen.gap < seen.closing**2 / np.abs(2.0 * seen.acceleration)
    return np.where(u <= w, 0.0, np.where(later < w, meets.astype(np.float64), reacting))


DRIVERS = {
    "cc": Driver(demand_cc, delay=0.75, release=RELEASE_BRAKING),
    "cc_lane": Driver(demand_cc_lane, delay=0.75, release=RELEASE_BRAKING),
    "reg157": Driver(demand_reg157, delay=_REG157_REACTION, braking=_REG157_BRAKING, jerk=math.inf),
    "rss": Driver(demand_rss, delay=_RSS_REACTION),
    "fsm": Driver(demand_fsm, delay=_FSM_REACTION),
}
"""The drivers by the names that scenarios use."""
