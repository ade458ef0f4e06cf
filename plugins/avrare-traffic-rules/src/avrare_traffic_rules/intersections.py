"""Predicates of formulas: stop lines, and conflict areas in which others have priority over the ego."""

from __future__ import annotations

import numpy as np

from avrare.driving import Crossing, Vehicles
from avrare.driving.frames import to_plane
from avrare.protocols import Floats
from avrare_traffic_rules.traffic import Bodies
from avrare_traffic_rules.vocabulary import Setting, predicate

_ALIGNED = 0.25 * np.pi  # largest angle between a vehicle and the way that it drives on [rad]


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
def crosses_right_before_left(s: Setting, a: Bodies, b: Bodies) -> Floats:
    """A is where the ways of a and b meet: one is the ego, the other comes from its right, at equal signs."""
    return _in_area(s, a, b, "right")


@predicate("mixed")
def crosses_priority_road(s: Setting, a: Bodies, b: Bodies) -> Floats:
    """A is where the ways of a and b meet: one is the ego, to the other signs give priority over it."""
    return _in_area(s, a, b, "sign")


@predicate("mixed")
def crosses_oncoming(s: Setting, a: Bodies, b: Bodies) -> Floats:
    """A is where the ways of a and b meet: one is the ego, turning left, the other oncoming and not."""
    return _in_area(s, a, b, "oncoming")


def _in_area(s: Setting, a: Bodies, b: Bodies, reason: str) -> Floats:
    number = np.maximum(a.number, b.number)  # of the other one
    values = np.full(np.broadcast_shapes(a.x.shape, b.x.shape), -np.inf)
    for area in (one for one in s.road.crossings if one.reason == reason):
        own = np.minimum(a.front - area.begin, area.end - a.rear) / s.scales.longitudinal
        here = np.where(a.number < 0, own, _on_way(s, a, area))
        takes = True if area.users is None else np.isin(number, area.users)
        values = np.maximum(values, np.where(takes & (a.number != b.number), here, -np.inf))
    return values


def _on_way(s: Setting, a: Bodies, area: Crossing) -> Floats:
    # a vehicle on another way, or across this one, is not in the area; one without a foot on the line neither
    plane = to_plane(s.road, Vehicles(a.x, a.y, a.heading, a.speed, a.acceleration))
    station, offset = area.line.to_road(plane.x, plane.y)
    turned = np.remainder(plane.heading - area.line.heading(station) + np.pi, 2.0 * np.pi) - np.pi
    half = 0.5 * a.length
    along = np.minimum(station + half - area.line_begin, area.line_end - station + half)
    parts = (
        along / s.scales.longitudinal,
        (area.half_width - np.abs(offset)) / s.scales.lateral,
        (_ALIGNED - np.abs(turned)) / s.scales.heading,
    )
    least = np.minimum.reduce(parts)
    return np.where(np.isnan(least), -np.inf, least)


def _greatest(a: Bodies, values: list[Floats]) -> Floats:
    return np.asarray(np.maximum.reduce([np.full(a.x.shape, -np.inf), *values]))
