"""Distances between vehicles, and predicates of which ones are safe."""

from __future__ import annotations

import numpy as np

from avrare.driving.geometry import Rectangle, signed_distance
from avrare.protocols import Floats
from avrare_traffic_rules.traffic import Bodies
from avrare_traffic_rules.vocabulary import Setting, predicate, quantity


@quantity("m")
def distance(s: Setting, a: Bodies, b: Bodies) -> Floats:
    """Between the rectangles of a and b; minus the depth of their overlap."""
    return signed_distance(_rectangle(a), _rectangle(b))


@quantity("m")
def gap(s: Setting, a: Bodies, b: Bodies) -> Floats:
    """From the front of a to the rear of b along the road; negative unless b is in front."""
    return b.rear - a.front


@predicate("longitudinal")
def keeps_safe_distance(s: Setting, a: Bodies, b: Bodies) -> Floats:
    """A can stop behind b if both brake as hard as they can, a after its reaction time."""
    behind, before = onward(a), onward(b)
    own, theirs = behind**2 / (2.0 * s.braking(a)), before**2 / (2.0 * s.braking(b))
    needed = np.maximum(own - theirs + behind * s.parameters.reaction_time, 0.0)
    return b.rear - a.front - needed


@quantity("s")
def time_to_collision(s: Setting, a: Bodies, b: Bodies) -> Floats:
    """Until the bounding boxes of a and b touch if both keep their velocities; infinite if they never do."""
    # closed intervals: boxes that touch now have met, whether they close or not
    reaches = (a.half_length + b.half_length, a.half_width + b.half_width)
    apart = (b.x - a.x, b.y - a.y)
    closing = (_along(a) - _along(b), _across(a) - _across(b))
    along, across = (_meeting(*axis) for axis in zip(apart, reaches, closing, strict=True))
    enter = np.maximum(np.maximum(along[0], across[0]), 0.0)
    return np.where(enter <= np.minimum(along[1], across[1]), enter, np.inf)


@predicate("time")
def keeps_time_to_collision(s: Setting, a: Bodies, b: Bodies) -> Floats:
    """The time to collision of a and b is ``least_time_to_collision`` or more."""
    return time_to_collision(s, a, b) - s.parameters.least_time_to_collision


@quantity("m")
def rss_longitudinal(s: Setting, a: Bodies, b: Bodies) -> Floats:
    """Room that a has behind b beyond the longitudinal RSS distance."""
    p = s.parameters
    rho, behind = p.rss_response_time, onward(a)
    faster = behind + rho * p.rss_acceleration
    own = behind * rho + 0.5 * p.rss_acceleration * rho**2 + faster**2 / (2.0 * p.rss_least_braking)
    needed = np.maximum(own - onward(b) ** 2 / (2.0 * p.rss_strongest_braking), 0.0)
    return b.rear - a.front - needed


@quantity("m")
def rss_lateral(s: Setting, a: Bodies, b: Bodies) -> Floats:
    """Room between a and b across the road beyond the lateral RSS distance."""
    to_b = np.where(b.y > a.y, 1.0, -1.0)
    approach = _approach(s, to_b * _across(a)) + _approach(s, -to_b * _across(b))
    between = np.abs(b.y - a.y) - a.half_width - b.half_width
    return between - s.parameters.rss_lateral_margin - np.maximum(approach, 0.0)


@predicate("longitudinal")
def keeps_rss_longitudinal(s: Setting, a: Bodies, b: Bodies) -> Floats:
    """A keeps the longitudinal RSS distance behind b."""
    return rss_longitudinal(s, a, b)


@predicate("lateral")
def keeps_rss_lateral(s: Setting, a: Bodies, b: Bodies) -> Floats:
    """A and b keep the lateral RSS distance."""
    return rss_lateral(s, a, b)


def onward(bodies: Bodies) -> Floats:
    """Speed of each vehicle for its braking distance along the road; 0 of one that moves against it [m/s].

    The speed itself, not its part along the road: one that changes lanes brakes along its heading.
    """
    return np.where(_along(bodies) > 0.0, np.abs(bodies.speed), 0.0)


def _approach(s: Setting, towards: Floats) -> Floats:
    """How far a vehicle may come towards the other: it speeds up for the response time, then brakes.

    One that is still moving away when it begins to brake is not relied on to go on doing so.
    """
    p = s.parameters
    rho, gained = p.rss_response_time, p.rss_response_time * p.rss_lateral_acceleration
    after = np.maximum(towards + gained, 0.0)
    return towards * rho + 0.5 * gained * rho + after**2 / (2.0 * p.rss_lateral_braking)


def _meeting(apart: Floats, reach: Floats, closing: Floats) -> tuple[Floats, Floats]:
    """When intervals on a line, ``apart`` between centres, begin and cease to overlap or touch [s]."""
    still = np.where(np.abs(apart) <= reach, np.inf, -np.inf)
    with np.errstate(divide="ignore", invalid="ignore"):
        one, two = (apart - reach) / closing, (apart + reach) / closing
    moving = closing != 0.0
    begin = np.where(moving, np.minimum(one, two), -still)
    return begin, np.where(moving, np.maximum(one, two), still)


def _rectangle(bodies: Bodies) -> Rectangle:
    return Rectangle(bodies.x, bodies.y, bodies.heading, bodies.length, bodies.width)


def _along(bodies: Bodies) -> Floats:
    return bodies.speed * np.cos(bodies.heading)


def _across(bodies: Bodies) -> Floats:
    return bodies.speed * np.sin(bodies.heading)
