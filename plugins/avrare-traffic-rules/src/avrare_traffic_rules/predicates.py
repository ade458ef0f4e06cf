"""Predicates and quantities of formulas: motion, distances."""

from __future__ import annotations

import numpy as np

from avrare.driving import Vehicles
from avrare.driving.geometry import Rectangle, signed_distance
from avrare.driving.values import to_plane
from avrare.protocols import Floats
from avrare_traffic_rules.traffic import Bodies
from avrare_traffic_rules.vocabulary import Setting, predicate, quantity

# Motion: speed, acceleration, heading


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
    """A brakes harder than b by more than ``abrupt_braking``."""
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
    limits = np.array([np.inf if lane_limit is None else lane_limit for lane_limit in limit]).reshape(
        -1, *[1] * a.speed.ndim
    )
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


# Distances between vehicles, and safe distances


@quantity("m")
def distance(s: Setting, a: Bodies, b: Bodies) -> Floats:
    """Distance between the rectangles of a and b; minus the depth of their overlap."""
    return signed_distance(_rectangle(s, a), _rectangle(s, b))


@quantity("m")
def gap(s: Setting, a: Bodies, b: Bodies) -> Floats:
    """Distance from the front of a to the rear of b along the road; negative unless b is in front."""
    return b.rear - a.front


@predicate("longitudinal")
def keeps_safe_distance(s: Setting, a: Bodies, b: Bodies) -> Floats:
    """A can stop behind b if both brake as hard as they can, a after its reaction time."""
    speed, speed_in_front = onward(a), onward(b)
    braking_distance = speed**2 / (2.0 * s.braking(a))
    braking_distance_in_front = speed_in_front**2 / (2.0 * s.braking(b))
    reaction_distance = speed * s.parameters.reaction_time
    safe_distance = np.maximum(braking_distance - braking_distance_in_front + reaction_distance, 0.0)
    return b.rear - a.front - safe_distance


@quantity("s")
def time_to_collision(s: Setting, a: Bodies, b: Bodies) -> Floats:
    """Time until the boxes of a and b touch at constant velocities; infinite if they never do."""
    # closed intervals: boxes that touch now have collided, whether they approach or not
    reaches = (a.half_length + b.half_length, a.half_width + b.half_width)
    offsets = (b.x - a.x, b.y - a.y)
    closing = (_along(a) - _along(b), _across(a) - _across(b))
    along, across = (_meeting(*axis) for axis in zip(offsets, reaches, closing, strict=True))
    enter = np.maximum(np.maximum(along[0], across[0]), 0.0)
    return np.where(enter <= np.minimum(along[1], across[1]), enter, np.inf)


@predicate("time")
def keeps_time_to_collision(s: Setting, a: Bodies, b: Bodies) -> Floats:
    """The time to collision of a and b is ``least_time_to_collision`` or more."""
    return time_to_collision(s, a, b) - s.parameters.least_time_to_collision


@quantity("m")
def rss_longitudinal(s: Setting, a: Bodies, b: Bodies) -> Floats:
    """Room that a has behind b, or before b that comes towards it, beyond the longitudinal RSS distance."""
    p = s.parameters
    stopping = _way_to_stop(s, onward(a), p.rss_least_braking)
    behind = np.maximum(stopping - onward(b) ** 2 / (2.0 * p.rss_strongest_braking), 0.0)
    both = sum(_way_to_stop(s, np.abs(each.speed), _least_braking(s, each)) for each in (a, b))
    meeting = (_along(a) >= 0.0) & (_along(b) < 0.0)
    return b.rear - a.front - np.where(meeting, both, behind)


@quantity("m")
def rss_lateral(s: Setting, a: Bodies, b: Bodies) -> Floats:
    """Room between a and b across the road beyond the lateral RSS distance."""
    to_b = np.where(b.y > a.y, 1.0, -1.0)
    approach = _approach(s, to_b * _across(a)) + _approach(s, -to_b * _across(b))
    between = np.abs(b.y - a.y) - a.half_width - b.half_width
    return between - s.parameters.rss_lateral_margin - np.maximum(approach, 0.0)


@predicate("longitudinal")
def keeps_rss_longitudinal(s: Setting, a: Bodies, b: Bodies) -> Floats:
    """A keeps the longitudinal RSS distance behind b, or before b that comes towards it."""
    return rss_longitudinal(s, a, b)


@predicate("lateral")
def keeps_rss_lateral(s: Setting, a: Bodies, b: Bodies) -> Floats:
    """A and b keep the lateral RSS distance."""
    return rss_lateral(s, a, b)


def onward(bodies: Bodies) -> Floats:
    """Return the speed of each vehicle for its braking distance; 0 if it moves against the road [m/s].

    The speed, not its component along the road: a vehicle that changes lanes brakes along its heading.
    """
    return np.where(_along(bodies) > 0.0, np.abs(bodies.speed), 0.0)


def _way_to_stop(s: Setting, speed: Floats, braking: Floats | float) -> Floats:
    # It accelerates for the response time, then brakes.
    rho, gain = s.parameters.rss_response_time, s.parameters.rss_acceleration
    return speed * rho + 0.5 * gain * rho**2 + (speed + rho * gain) ** 2 / (2.0 * braking)


def _least_braking(s: Setting, bodies: Bodies) -> Floats:
    # Of who meets oncoming traffic, by whether it touches a lane of the other direction.
    opposing = np.isin(np.arange(len(bodies.lanes)), s.road.opposing)
    along, against = (
        bodies.lanes[lanes].max(axis=0, initial=-np.inf) >= 0.0 for lanes in (opposing, ~opposing)
    )
    wrong = np.where(_along(bodies) < 0.0, against, along)
    return np.where(wrong, s.parameters.rss_least_braking, s.parameters.rss_least_braking_correct)


def _approach(s: Setting, towards: Floats) -> Floats:
    # It accelerates for the response time, then brakes; if it still moves away then, it stops at once.
    p = s.parameters
    rho, gained = p.rss_response_time, p.rss_response_time * p.rss_lateral_acceleration
    after = np.maximum(towards + gained, 0.0)
    return towards * rho + 0.5 * gained * rho + after**2 / (2.0 * p.rss_lateral_braking)


def _meeting(apart: Floats, reach: Floats, closing: Floats) -> tuple[Floats, Floats]:
    """Return when intervals on a line, ``apart`` between centres, begin and cease to touch [s]."""
    still = np.where(np.abs(apart) <= reach, np.inf, -np.inf)
    with np.errstate(divide="ignore", invalid="ignore"):
        first, second = (apart - reach) / closing, (apart + reach) / closing
    moving = closing != 0.0
    begin = np.where(moving, np.minimum(first, second), -still)
    return begin, np.where(moving, np.maximum(first, second), still)


def _rectangle(s: Setting, bodies: Bodies) -> Rectangle:
    plain = Vehicles(bodies.x, bodies.y, bodies.heading, bodies.speed, bodies.acceleration)
    plane = to_plane(s.road, plain)
    return Rectangle(plane.x, plane.y, plane.heading, bodies.length, bodies.width)


def _along(bodies: Bodies) -> Floats:
    return bodies.speed * np.cos(bodies.heading)


def _across(bodies: Bodies) -> Floats:
    return bodies.speed * np.sin(bodies.heading)
