"""Predicates of the interstate rules as robustness: positive where they hold, in scaled units.

Every predicate of the ego and one other vehicle is an array (N, V); those of the ego alone are (N,).
Definitions follow Maierhofer et al. 2020; those that lean on the rectangle's extent, not its centre, say so.
"""

from __future__ import annotations

import numpy as np

from avrare.protocols import Floats
from avrare_traffic_rules.config import TrafficRuleConfig
from avrare_traffic_rules.traffic import Bodies, Traffic, bounding_box


class Predicates:
    """The predicates of one configuration.

    Args:
        config: Parameters and scales.
    """

    extents = staticmethod(bounding_box)
    """What counts as front, rear and sides of a vehicle."""

    def __init__(self, config: TrafficRuleConfig) -> None:
        self.config = config
        self.scales = config.scales

    def in_lane(self, bodies: Bodies, traffic: Traffic) -> Floats:
        """(L, N, V): the rectangle and lane l overlap."""
        centres = np.array(traffic.road.lane_centres)[:, None, None]
        room = 0.5 * traffic.road.lane_width + bodies.half_width
        return np.asarray((room - np.abs(bodies.y - centres)) / self.scales.lateral)

    def in_same_lane(self, t: Traffic) -> Floats:
        """Ego and o occupy a common lane."""
        return np.asarray(np.minimum(self.in_lane(t.ego, t), self.in_lane(t.others, t)).max(axis=0))

    def in_front_of(self, t: Traffic) -> Floats:
        """The rear of o is beyond the front of the ego."""
        return (t.others.rear - t.ego.front) / self.scales.longitudinal

    def single_lane(self, t: Traffic) -> Floats:
        """O touches one lane only."""
        inside = self.in_lane(t.others, t)
        lanes = range(len(inside))
        alone = [
            np.min([inside[lane] if lane == own else -inside[lane] for lane in lanes], axis=0)
            for own in lanes
        ]
        return np.asarray(np.max(alone, axis=0))

    def cut_in(self, t: Traffic) -> Floats:
        """O changes lanes towards the ego and already shares one with it."""
        left = (t.others.y - t.ego.y) / self.scales.lateral
        turning_left = t.others.heading / self.scales.heading
        approaching = np.maximum(np.minimum(left, -turning_left), np.minimum(-left, turning_left))
        return np.minimum(np.minimum(-self.single_lane(t), approaching), self.in_same_lane(t))

    def keeps_safe_distance(self, t: Traffic) -> Floats:
        """The ego can stop behind o if both brake as hard as they can, after the ego's reaction time."""
        c = self.config
        own, theirs = t.ego.speed**2 / (2.0 * c.ego_braking), t.others.speed**2 / (2.0 * c.others_braking)
        needed = np.maximum(own - theirs + t.ego.speed * c.reaction_time, 0.0)
        return (t.others.rear - t.ego.front - needed) / self.scales.longitudinal

    def precedes(self, t: Traffic) -> Floats:
        """O is the nearest vehicle in front of the ego in its lane."""
        ahead = np.minimum(self.in_front_of(t), self.in_same_lane(t))
        nearer = (t.others.rear[:, :, None] - t.others.rear[:, None, :]) / self.scales.longitudinal
        between = np.minimum(ahead[:, None, :], nearer)
        own = np.eye(between.shape[1], dtype=bool)
        nearest = -np.where(own, -np.inf, between).max(axis=2, initial=-np.inf)
        return np.asarray(np.minimum(ahead, nearest))

    def brakes_abruptly(self, t: Traffic) -> Floats:
        """(N,) the ego brakes harder than a_abrupt."""
        return (self.config.abrupt_braking - t.ego.acceleration[:, 0]) / self.scales.acceleration

    def brakes_abruptly_relative(self, t: Traffic) -> Floats:
        """The ego brakes harder than a_abrupt beyond what o brakes."""
        own = t.ego.acceleration - np.minimum(t.others.acceleration, 0.0)
        return (self.config.abrupt_braking - own) / self.scales.acceleration

    def slow(self, t: Traffic) -> Floats:
        """O is much slower than the limit."""
        return (self.config.speed_limit - self.config.slow_difference - t.others.speed) / self.scales.speed

    def preserves_flow(self, t: Traffic) -> Floats:
        """(N,) the ego is not much slower than the limit."""
        return (t.ego.speed[:, 0] - self.config.speed_limit + self.config.slow_difference) / self.scales.speed

    def left_of(self, t: Traffic) -> Floats:
        """O is beside the ego, wholly to its left."""
        aside = (t.others.y - t.others.half_width - t.ego.y - t.ego.half_width) / self.scales.lateral
        overlap = np.minimum(t.ego.front - t.others.rear, t.others.front - t.ego.rear)
        return np.minimum(aside, overlap / self.scales.longitudinal)

    def drives_faster(self, t: Traffic) -> Floats:
        """The ego is faster than o."""
        return (t.ego.speed - t.others.speed) / self.scales.speed

    def drives_slightly_faster(self, t: Traffic) -> Floats:
        """The ego is faster than o by no more than a little."""
        return (self.config.slightly_faster - (t.ego.speed - t.others.speed)) / self.scales.speed

    def in_slow_traffic(self, t: Traffic) -> Floats:
        """At least ``queue_size`` other vehicles ahead of o in its lane are slow; the ego does not count."""
        inside = self.in_lane(t.others, t)
        same = np.minimum(inside[:, :, :, None], inside[:, :, None, :]).max(axis=0)
        ahead = (t.others.rear[:, None, :] - t.others.front[:, :, None]) / self.scales.longitudinal
        slow = (self.config.queue_speed - t.others.speed[:, None, :]) / self.scales.speed
        own = np.eye(slow.shape[2], dtype=bool)
        each = np.where(own, -np.inf, np.minimum(np.minimum(same, ahead), slow))
        count = self.config.queue_size
        if each.shape[2] < count:
            return np.full(t.others.x.shape, -np.inf)
        return np.asarray(-np.sort(-each, axis=2)[:, :, count - 1])

    def on_access_ramp(self, t: Traffic) -> Floats:
        """(N,) the ego touches a lane of an access ramp."""
        lanes = list(t.road.access_ramp)
        return np.asarray(self.in_lane(t.ego, t)[lanes].max(axis=0, initial=-np.inf)[:, 0])

    def on_main_carriageway(self, t: Traffic) -> Floats:
        """O touches a lane of the main carriageway."""
        lanes = [lane for lane in range(len(t.road.lane_centres)) if lane not in t.road.access_ramp]
        return np.asarray(self.in_lane(t.others, t)[lanes].max(axis=0, initial=-np.inf))
