"""Predicates of how vehicles move: speed, acceleration, heading."""

from __future__ import annotations

import numpy as np

from avrare.protocols import Floats
from avrare_traffic_rules.traffic import Bodies
from avrare_traffic_rules.vocabulary import Setting, predicate, quantity


@quantity("m/s")
def speed(s: Setting, a: Bodies) -> Floats:
    """Speed of a along its heading."""
    return a.speed


@quantity("m/s^2")
def acceleration(s: Setting, a: Bodies) -> Floats:
    """Acceleration of a along its heading."""
    return a.acceleration


@quantity("rad")
def heading(s: Setting, a: Bodies) -> Floats:
    """Heading of a against the road, left is positive."""
    return a.heading


@predicate("acceleration")
def brakes(s: Setting, a: Bodies) -> Floats:
    """A slows down."""
    return np.asarray(-a.acceleration)


@predicate("acceleration")
def brakes_abruptly(s: Setting, a: Bodies) -> Floats:
    """A brakes harder than ``abrupt_braking``."""
    return s.parameters.abrupt_braking - a.acceleration


@predicate("acceleration")
def brakes_abruptly_relative(s: Setting, a: Bodies, b: Bodies) -> Floats:
    """A brakes harder than ``abrupt_braking`` beyond what b brakes."""
    return s.parameters.abrupt_braking - (a.acceleration - np.minimum(b.acceleration, 0.0))


@predicate("speed")
def slow(s: Setting, a: Bodies) -> Floats:
    """A is slower than ``speed_limit`` by more than ``slow_difference``."""
    return s.parameters.speed_limit - s.parameters.slow_difference - a.speed


@predicate("speed")
def preserves_flow(s: Setting, a: Bodies) -> Floats:
    """A is slower than ``speed_limit`` by less than ``slow_difference``."""
    return a.speed - s.parameters.speed_limit + s.parameters.slow_difference


@predicate("speed")
def drives_faster(s: Setting, a: Bodies, b: Bodies) -> Floats:
    """A is faster than b."""
    return a.speed - b.speed


@predicate("speed")
def drives_slightly_faster(s: Setting, a: Bodies, b: Bodies) -> Floats:
    """A is faster than b by less than ``slightly_faster``, or not faster at all."""
    return s.parameters.slightly_faster - (a.speed - b.speed)


@predicate("speed")
def has_congestion_speed(s: Setting, a: Bodies) -> Floats:
    """A is slower than ``congestion_speed``."""
    return s.parameters.congestion_speed - a.speed


@predicate("speed")
def has_slow_traffic_speed(s: Setting, a: Bodies) -> Floats:
    """A is slower than ``slow_traffic_speed``."""
    return s.parameters.slow_traffic_speed - a.speed


@predicate("speed")
def has_queue_speed(s: Setting, a: Bodies) -> Floats:
    """A is slower than ``queue_speed``."""
    return s.parameters.queue_speed - a.speed


@predicate("speed")
def stands(s: Setting, a: Bodies) -> Floats:
    """A is slower than ``standstill_speed`` either way."""
    return s.parameters.standstill_speed - np.abs(a.speed)


@predicate("speed")
def reverses(s: Setting, a: Bodies) -> Floats:
    """A goes backwards faster than ``standstill_speed``."""
    return -s.parameters.standstill_speed - a.speed


@predicate("heading")
def turns_around(s: Setting, a: Bodies) -> Floats:
    """A is turned against the road by more than ``turn_heading``."""
    turned = np.abs(np.remainder(a.heading + np.pi, 2.0 * np.pi) - np.pi)
    return turned - s.parameters.turn_heading


@predicate("mixed")
def keeps_lane_limit(s: Setting, a: Bodies) -> Floats:
    """A is not faster than the limit of any lane that it touches."""
    limit = s.parameters.lane_limit
    if not isinstance(limit, tuple):
        return ((np.inf if limit is None else limit) - a.speed) / s.scales.speed
    limits = np.array([np.inf if one is None else one for one in limit]).reshape(-1, *[1] * a.speed.ndim)
    below = (limits - a.speed) / s.scales.speed
    return np.asarray(np.maximum(-a.lanes / s.scales.lateral, below).min(axis=0))


@predicate("speed")
def keeps_type_limit(s: Setting, a: Bodies) -> Floats:
    """A is not faster than ``truck_limit``, if it is the ego and a truck."""
    truck = s.parameters.vehicle_type == "truck"
    return np.where(truck & (a.number < 0), s.parameters.truck_limit, np.inf) - a.speed


@predicate("speed")
def keeps_view_limit(s: Setting, a: Bodies) -> Floats:
    """A can stop within ``field_of_view``: v t + v^2 / 2b is not more."""
    b, t = s.braking(a), s.parameters.reaction_time
    return b * (np.sqrt(t**2 + 2.0 * s.parameters.field_of_view / b) - t) - a.speed


@predicate("speed")
def keeps_braking_limit(s: Setting, a: Bodies) -> Floats:
    """A brakes to a stop within ``braking_distance``: v^2 / 2b is not more."""
    return np.sqrt(2.0 * s.braking(a) * s.parameters.braking_distance) - a.speed
