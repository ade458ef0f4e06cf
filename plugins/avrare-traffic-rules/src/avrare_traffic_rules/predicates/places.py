"""Predicates of where vehicles are: lanes, who is ahead, who is beside."""

from __future__ import annotations

import numpy as np

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
    """A is beside b, wholly to its left."""
    aside = (a.y - a.half_width - b.y - b.half_width) / s.scales.lateral
    beside = np.minimum(b.front - a.rear, a.front - b.rear)
    return np.minimum(aside, beside / s.scales.longitudinal)


@predicate("lateral")
def single_lane(s: Setting, a: Bodies) -> Floats:
    """A touches one lane only."""
    lanes = range(len(a.lanes))
    alone = [
        np.min([a.lanes[lane] if lane == own else -a.lanes[lane] for lane in lanes], axis=0) for own in lanes
    ]
    return np.asarray(np.max(alone, axis=0))


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
    """A touches a lane that is no access ramp and no shoulder."""
    return _touches(a, s.main_lanes)


@predicate("lateral")
def on_shoulder(s: Setting, a: Bodies) -> Floats:
    """A touches a shoulder."""
    return _touches(a, list(s.parameters.shoulder))


@predicate("lateral")
def in_right_lane(s: Setting, a: Bodies) -> Floats:
    """A touches the rightmost lane of the main carriageway."""
    return _touches(a, s.main_lanes[:1])


@predicate("lateral")
def in_leftmost_lane(s: Setting, a: Bodies) -> Floats:
    """A touches the leftmost lane of the main carriageway."""
    return _touches(a, s.main_lanes[-1:])


@predicate("mixed")
def on_broad_road(s: Setting, a: Bodies) -> Floats:
    """The main carriageway is at least as wide as a broad road: infinite, or minus infinite."""
    broad = len(s.main_lanes) * s.road.lane_width >= s.parameters.broad_road
    return np.full(a.x.shape, np.inf if broad else -np.inf)


@predicate("lateral")
def keeps_right(s: Setting, a: Bodies) -> Floats:
    """The right side of a is near the right border of every lane that it touches, or beyond it."""
    return _kept(s, a, a.y - a.half_width, -0.5 * s.road.lane_width, 1.0)


@predicate("lateral")
def keeps_left(s: Setting, a: Bodies) -> Floats:
    """The left side of a is near the left border of every lane that it touches, or beyond it."""
    return _kept(s, a, a.y + a.half_width, 0.5 * s.road.lane_width, -1.0)


def _touches(a: Bodies, lanes: list[int]) -> Floats:
    return np.asarray(a.lanes[lanes].max(axis=0, initial=-np.inf))


def _kept(s: Setting, a: Bodies, side: Floats, border: float, inwards: float) -> Floats:
    """The least over lanes of: a is outside, or its side is no farther inwards than allowed."""
    borders = np.array(s.road.lane_centres).reshape(-1, *[1] * a.y.ndim) + border
    near = s.parameters.border_distance - inwards * (side - borders)
    return np.asarray(np.maximum(-a.lanes, near).min(axis=0))
