"""Predicates of formulas: stop lines, lights, and conflict areas where others have priority over the ego."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from avrare.driving import Crossing, Vehicles
from avrare.driving.reference_line import ReferenceLine
from avrare.driving.values import RED, YELLOW, to_plane
from avrare.protocols import Floats
from avrare_traffic_rules.traffic import Bodies
from avrare_traffic_rules.vocabulary import Setting, predicate

LIT = frozenset({"on_red_line", "on_yellow_line", "before_yellow_line", "can_stop_at_yellow"})
"""Names of the predicates that read the colours of lights."""


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


@predicate("longitudinal")
def on_light_line(s: Setting, a: Bodies) -> Floats:
    """A covers the line of a traffic light."""
    return _greatest(a, [np.minimum(a.front - line, line - a.rear) for line in s.road.light_lines])


@predicate("longitudinal")
def on_red_line(s: Setting, a: Bodies) -> Floats:
    """A covers the line of a traffic light that is red."""
    return _at_lights(s, a, RED, lambda line: np.minimum(a.front - line, line - a.rear))


@predicate("longitudinal")
def on_yellow_line(s: Setting, a: Bodies) -> Floats:
    """A covers the line of a traffic light that is yellow."""
    return _at_lights(s, a, YELLOW, lambda line: np.minimum(a.front - line, line - a.rear))


@predicate("longitudinal")
def before_yellow_line(s: Setting, a: Bodies) -> Floats:
    """The front of a is before the line of a traffic light that is yellow."""
    return _at_lights(s, a, YELLOW, lambda line: line - a.front)


@predicate("longitudinal")
def can_stop_at_yellow(s: Setting, a: Bodies) -> Floats:
    """The front of a is before the line of a yellow light by more than a stop at ``yellow_braking`` takes."""
    stopping = a.speed**2 / (2.0 * s.parameters.yellow_braking)
    return _at_lights(s, a, YELLOW, lambda line: line - a.front - stopping)


@predicate("mixed")
def crosses_right_before_left(s: Setting, a: Bodies, b: Bodies) -> Floats:
    """A is where the ways of a and b meet: one is the ego, the other comes from its right, at equal signs."""
    return _maximise_over_areas(s, a, b, "right", _is_in_area)


@predicate("mixed")
def crosses_priority_road(s: Setting, a: Bodies, b: Bodies) -> Floats:
    """A is where the ways of a and b meet: one is the ego, to the other signs give priority over it."""
    return _maximise_over_areas(s, a, b, "sign", _is_in_area)


@predicate("mixed")
def crosses_oncoming(s: Setting, a: Bodies, b: Bodies) -> Floats:
    """A is where the ways of a and b meet: one is the ego, turning left, the other oncoming and not."""
    return _maximise_over_areas(s, a, b, "oncoming", _is_in_area)


@predicate("mixed")
def brakes_right_before_left(s: Setting, a: Bodies, b: Bodies) -> Floats:
    """A brakes, as ``made_to_brake`` says, near where it meets b, the ego, and comes from its right."""
    return _maximise_over_areas(s, a, b, "right", _brakes_before_area)


@predicate("mixed")
def brakes_on_priority_road(s: Setting, a: Bodies, b: Bodies) -> Floats:
    """A brakes, as ``made_to_brake`` says, near where it meets b, the ego, and signs prefer it."""
    return _maximise_over_areas(s, a, b, "sign", _brakes_before_area)


@predicate("mixed")
def brakes_oncoming(s: Setting, a: Bodies, b: Bodies) -> Floats:
    """A brakes, as ``made_to_brake`` says, near where it meets b, the ego, which turns left."""
    return _maximise_over_areas(s, a, b, "oncoming", _brakes_before_area)


def _at_lights(s: Setting, a: Bodies, colour: float, value: Callable[[float], Floats]) -> Floats:
    # lights are those on the ego's way
    shape = (-1, *[1] * (a.x.ndim - 1))
    matches = [np.reshape(light, shape) == colour for light in s.lights]
    values = [
        np.where(here & (a.number < 0), value(line), -np.inf)
        for here, line in zip(matches, s.road.light_lines, strict=True)
    ]
    return _greatest(a, values)


def _maximise_over_areas(
    s: Setting, a: Bodies, b: Bodies, reason: str, value: Callable[[Setting, Bodies, Crossing], Floats]
) -> Floats:
    number, way = np.maximum(a.number, b.number), np.maximum(a.way, b.way)  # of the other one
    values = np.full(np.broadcast_shapes(a.x.shape, b.x.shape), -np.inf)
    for area in (crossing for crossing in s.road.crossings if crossing.reason == reason):
        takes = True if area.users is None else np.isin(number, area.users)
        takes = takes if area.way is None else takes & (way == area.way)
        here = np.where(takes & (a.number != b.number), value(s, a, area), -np.inf)
        values = np.maximum(values, here)
    return values


def _is_in_area(s: Setting, a: Bodies, area: Crossing) -> Floats:
    if area.ego_line is None:
        ego = np.minimum(a.front - area.begin, area.end - a.rear) / s.scales.longitudinal
    else:
        station, sideways = _measure_along_way(s, a, area.ego_line, area.half_width)
        ego = np.minimum(_measure_overlap(s, a, station, area.begin, area.end), sideways)
    station, sideways = _measure_along_way(s, a, area.line, area.half_width)
    other = np.minimum(_measure_overlap(s, a, station, area.line_begin, area.line_end), sideways)
    least = np.where(a.number < 0, ego, other)
    return np.where(np.isnan(least), -np.inf, least)


def _brakes_before_area(s: Setting, a: Bodies, area: Crossing) -> Floats:
    station, sideways = _measure_along_way(s, a, area.line, area.half_width)
    gap = area.line_begin - station - 0.5 * a.length
    near = np.minimum(gap, s.parameters.made_to_brake_distance - gap) / s.scales.longitudinal
    brakes = (s.parameters.made_to_brake - a.acceleration) / s.scales.acceleration
    least = np.minimum.reduce([near, brakes, sideways])
    return np.where(np.isnan(least) | (a.number < 0), -np.inf, least)


def _measure_along_way(
    s: Setting, a: Bodies, line: ReferenceLine, half_width: float
) -> tuple[Floats, Floats]:
    # a vehicle on another way, or across this one, is not on it; one without a foot on the line neither
    plane = to_plane(s.road, Vehicles(a.x, a.y, a.heading, a.speed, a.acceleration))
    station, offset = line.to_road(plane.x, plane.y)
    turned = np.remainder(plane.heading - line.heading(station) + np.pi, 2.0 * np.pi) - np.pi
    sideways = (half_width - np.abs(offset)) / s.scales.lateral
    along_way = (0.25 * np.pi - np.abs(turned)) / s.scales.heading  # turned by less than 45 degrees
    return station, np.minimum(sideways, along_way)


def _measure_overlap(s: Setting, a: Bodies, station: Floats, begin: float, end: float) -> Floats:
    half = 0.5 * a.length
    return np.minimum(station + half - begin, end - station + half) / s.scales.longitudinal


def _greatest(a: Bodies, values: list[Floats]) -> Floats:
    return np.asarray(np.maximum.reduce([np.full(a.x.shape, -np.inf), *values]))
