"""Predicates of formulas: positions in lanes, ahead and beside."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from avrare.driving.lanes import is_outermost, lane_borders, lane_exists
from avrare.protocols import Floats
from avrare_traffic_rules.traffic import Bodies
from avrare_traffic_rules.vocabulary import Setting, predicate


@predicate("lateral")
def in_same_lane(s: Setting, a: Bodies, b: Bodies) -> Floats:
    """A and b occupy a common lane."""
    return np.asarray(np.minimum(a.lanes, b.lanes).max(axis=0))


@predicate("longitudinal")
def in_front_of(s: Setting, a: Bodies, b: Bodies) -> Floats:
    """The rear of a is beyond the front of b."""
    return a.rear - b.front


@predicate("longitudinal")
def nearer(s: Setting, a: Bodies, b: Bodies) -> Floats:
    """The rear of a is less far along the road than the rear of b."""
    return b.rear - a.rear


@predicate("mixed")
def other_than(s: Setting, a: Bodies, b: Bodies) -> Floats:
    """A and b are two vehicles, not one: infinite, or minus infinite."""
    return np.where(a.number == b.number, -np.inf, np.inf)


@predicate("mixed")
def left_of(s: Setting, a: Bodies, b: Bodies) -> Floats:
    """A is beside b, wholly to its left; oncoming or crossing traffic does not count."""
    aside = (a.y - a.half_width - b.y - b.half_width) / s.scales.lateral
    overlap = np.minimum(b.front - a.rear, a.front - b.rear)
    left = np.minimum(aside, overlap / s.scales.longitudinal)
    return np.minimum(left, _same_way(a, b)) if s.road.opposing or s.road.lanes else left


@predicate("lateral")
def single_lane(s: Setting, a: Bodies) -> Floats:
    """A touches one lane only."""
    lanes = range(len(a.lanes))
    only = [
        np.min([a.lanes[lane] if lane == occupied else -a.lanes[lane] for lane in lanes], axis=0)
        for occupied in lanes
    ]
    return np.asarray(np.max(only, axis=0))


@predicate("mixed")
def cut_in(s: Setting, a: Bodies, b: Bodies) -> Floats:
    """A changes lanes towards b and already shares one with it."""
    left = (a.y - b.y) / s.scales.lateral
    turning_left = a.heading / s.scales.heading
    approaching = np.maximum(np.minimum(left, -turning_left), np.minimum(-left, turning_left))
    return np.minimum(np.minimum(-single_lane(s, a), approaching), in_same_lane(s, a, b))


@predicate("lateral")
def on_access_ramp(s: Setting, a: Bodies) -> Floats:
    """A touches a lane of an access ramp."""
    return _touches(a, list(s.road.access_ramp))


@predicate("lateral")
def on_main_carriageway(s: Setting, a: Bodies) -> Floats:
    """A touches a lane other than an access ramp or a shoulder."""
    return _touches(a, s.main_lanes)


@predicate("lateral")
def on_shoulder(s: Setting, a: Bodies) -> Floats:
    """A touches a shoulder."""
    return _touches(a, s.shoulders)


@predicate("lateral")
def in_right_lane(s: Setting, a: Bodies) -> Floats:
    """A touches the rightmost lane of the main carriageway."""
    return _touches_outermost(s, a, -1.0)


@predicate("lateral")
def in_leftmost_lane(s: Setting, a: Bodies) -> Floats:
    """A touches the leftmost lane of the main carriageway."""
    return _touches_outermost(s, a, 1.0)


@predicate("mixed")
def on_broad_road(s: Setting, a: Bodies) -> Floats:
    """The main carriageway is at least as wide as a broad road: infinite, or minus infinite."""
    if s.road.lanes:
        right, left = lane_borders(s.road, a.x)
        widths = np.where(lane_exists(s.road, a.x), left - right, 0.0)[s.main_lanes]
        return np.where(widths.sum(axis=0) >= s.parameters.broad_road, np.inf, -np.inf)
    broad = len(s.main_lanes) * s.road.lane_width >= s.parameters.broad_road
    return np.full(a.x.shape, np.inf if broad else -np.inf)


@predicate("lateral")
def keeps_right(s: Setting, a: Bodies) -> Floats:
    """The right side of a is near the right border of every lane that it touches, or beyond it."""
    return _near_border(s, a, a.y - a.half_width, 0, 1.0)


@predicate("lateral")
def keeps_left(s: Setting, a: Bodies) -> Floats:
    """The left side of a is near the left border of every lane that it touches, or beyond it."""
    return _near_border(s, a, a.y + a.half_width, 1, -1.0)


@predicate("mixed")
def close_on_left(s: Setting, a: Bodies, b: Bodies) -> Floats:
    """A is beside b, to its left, with less than ``beside_distance`` between them."""
    between = a.y - a.half_width - b.y - b.half_width
    return np.minimum(left_of(s, a, b), (s.parameters.beside_distance - between) / s.scales.lateral)


@predicate("mixed")
def close_on_right(s: Setting, a: Bodies, b: Bodies) -> Floats:
    """A is beside b, to its right, with less than ``beside_distance`` between them."""
    between = b.y - b.half_width - a.y - a.half_width
    return np.minimum(left_of(s, b, a), (s.parameters.beside_distance - between) / s.scales.lateral)


@predicate("lateral")
def right_of_broad_marking(s: Setting, a: Bodies) -> Floats:
    """A is wholly to the right of a broad lane marking."""
    return _beside_broad_marking(s, a, lambda marking: marking - a.y - a.half_width)


@predicate("lateral")
def left_of_broad_marking(s: Setting, a: Bodies) -> Floats:
    """A is wholly to the left of a broad lane marking."""
    return _beside_broad_marking(s, a, lambda marking: a.y - a.half_width - marking)


def _beside_broad_marking(s: Setting, a: Bodies, room: Callable[[Floats], Floats]) -> Floats:
    marked = list(s.road.broad_markings)
    markings = np.where(lane_exists(s.road, a.x), lane_borders(s.road, a.x)[1], np.nan)[marked]
    return np.asarray(np.nan_to_num(room(markings), nan=-np.inf).max(axis=0, initial=-np.inf))


def _same_way(a: Bodies, b: Bodies) -> Floats:
    return np.where(np.cos(a.heading - b.heading) > 0.5, np.inf, -np.inf)


def _touches_outermost(s: Setting, a: Bodies, side: float) -> Floats:
    if not s.road.lanes:
        return _touches(a, s.main_lanes[-1:] if side > 0.0 else s.main_lanes[:1])
    outermost = is_outermost(s.road, s.main_lanes, a.x, side)
    return np.asarray(np.where(outermost, a.lanes, -np.inf).max(axis=0, initial=-np.inf))


def _touches(a: Bodies, lanes: list[int]) -> Floats:
    return np.asarray(a.lanes[lanes].max(axis=0, initial=-np.inf))


def _near_border(s: Setting, a: Bodies, side: Floats, border: int, inwards: float) -> Floats:
    borders = lane_borders(s.road, a.x)[border]
    near = s.parameters.border_distance - inwards * (side - borders)
    return np.asarray(np.maximum(-a.lanes, near).min(axis=0))
