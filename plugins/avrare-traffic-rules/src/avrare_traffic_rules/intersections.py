"""Predicates of formulas: stop lines, and conflict areas in which others have priority over the ego."""

from __future__ import annotations

import numpy as np

from avrare.driving import Crossing, Vehicles
from avrare.driving.frames import to_plane
from avrare.protocols import Floats
from avrare_traffic_rules.traffic import Bodies
from avrare_traffic_rules.vocabulary import Setting, predicate

_WITH = 0.25 * np.pi  # largest angle between a vehicle and the way that it drives on [rad]


@predicate("longitudinal")
def at_stop_line(s: Setting, a: Bodies) -> Floats:
    """The front of a is before the line of a stop sign by at most ``stop_line_distance``."""
    reach = s.parameters.stop_line_distance
    gaps = [line - a.front for line in s.road.stop_signs]
    return _greatest(a, [np.minimum(gap, reach - gap) for gap in gaps])


@predicate("longitudinal")
def on_stop_line(s: Setting, a: Bodies) -> Floats:
    """A covers the line of a stop sign."""
    return _greatest(a, [np.minimum(a.front - line, line - a.rear) for line in s.road.stop_signs])


@predicate("speed")
def stands_at_sign(s: Setting, a: Bodies) -> Floats:
    """A is slower than ``stop_speed`` either way."""
    return s.parameters.stop_speed - np.abs(a.speed)


@predicate("mixed")
def crosses_right_before_left(s: Setting, a: Bodies) -> Floats:
    """A is where the ways of the ego and of traffic from its right meet, and signs prefer neither."""
    return _in_area(s, a, "right")


@predicate("mixed")
def crosses_priority_road(s: Setting, a: Bodies) -> Floats:
    """A is where the way of the ego meets that of traffic to which signs give priority over it."""
    return _in_area(s, a, "sign")


@predicate("mixed")
def crosses_oncoming(s: Setting, a: Bodies) -> Floats:
    """A is where the ego's left turn meets the way of oncoming traffic that does not turn left."""
    return _in_area(s, a, "oncoming")


def _in_area(s: Setting, a: Bodies, reason: str) -> Floats:
    areas = [one for one in s.road.crossings if one.reason == reason]
    if not areas:
        return _greatest(a, [])
    own = [np.minimum(a.front - one.begin, one.end - a.rear) / s.scales.longitudinal for one in areas]
    plain = Vehicles(a.x, a.y, a.heading, a.speed, a.acceleration)
    plane = to_plane(s.road, plain)
    theirs = [_on_way(s, a, plane, one) for one in areas]
    return np.where(a.number < 0, _greatest(a, own), _greatest(a, theirs))


def _on_way(s: Setting, a: Bodies, plane: Vehicles, area: Crossing) -> Floats:
    # a vehicle on another way, or across this one, is not in the area; one without a foot on the line neither
    station, offset = area.line.to_road(plane.x, plane.y)
    turned = np.remainder(plane.heading - area.line.heading(station) + np.pi, 2.0 * np.pi) - np.pi
    half = 0.5 * a.length
    along = np.minimum(station + half - area.line_begin, area.line_end - station + half)
    parts = (
        along / s.scales.longitudinal,
        (area.half_width - np.abs(offset)) / s.scales.lateral,
        (_WITH - np.abs(turned)) / s.scales.heading,
    )
    least = np.minimum.reduce(parts)
    return np.where(np.isnan(least), -np.inf, least)


def _greatest(a: Bodies, values: list[Floats]) -> Floats:
    return np.asarray(np.maximum.reduce([np.full(a.x.shape, -np.inf), *values]))
