"""The predicates as the published code of Innes and Ramamoorthy defines them, to compare with its numbers.

Lanes are bands of half their width, tested at five points of the body; front, rear and sides are the middles
of the rectangle's edges; the safe distance is one car length; metres, metres per second and radians meet in
one minimum, unscaled.
"""

from __future__ import annotations

import numpy as np

from avrare.protocols import Floats
from avrare_traffic_rules.config import Scales, TrafficRuleConfig
from avrare_traffic_rules.predicates import Predicates
from avrare_traffic_rules.traffic import Bodies, Traffic

_UNSCALED = Scales(longitudinal=1.0, lateral=1.0, speed=1.0, acceleration=1.0, heading=1.0)


def edge_middles(length: Floats, width: Floats, heading: Floats) -> tuple[Floats, Floats]:
    """From the centre to the middle of the front edge along the road, of the left edge across it."""
    return 0.5 * length * np.cos(heading), 0.5 * width * np.cos(heading)


class PublishedPredicates(Predicates):
    """The same names with the published meanings."""

    extents = staticmethod(edge_middles)

    def __init__(self, config: TrafficRuleConfig) -> None:
        super().__init__(config)
        self.scales = _UNSCALED

    def in_lane(self, bodies: Bodies, traffic: Traffic) -> Floats:
        """(L, N, V): one of centre, front, rear, left and right middle lies in the lane's inner half."""
        along = 0.5 * bodies.length * np.sin(bodies.heading)
        across = 0.5 * bodies.width * np.cos(bodies.heading)
        points = np.stack([bodies.y + d for d in (0.0 * along, along, -along, across, -across)])
        centres = np.array(traffic.road.lane_centres)[:, None, None]
        nearest = np.abs(points[:, None] - centres).min(axis=0)
        return np.asarray(0.25 * traffic.road.lane_width - nearest)

    def keeps_safe_distance(self, t: Traffic) -> Floats:
        """A gap of one length of the other vehicle."""
        return t.others.rear - t.ego.front - t.others.length

    def left_of(self, t: Traffic) -> Floats:
        """The rear of o, all of the ego, or the front of o is beside the other; o is to the left."""
        ego, o = t.ego, t.others
        aside = o.y - o.half_width - ego.y - ego.half_width
        rear = np.minimum(o.rear - ego.rear, ego.front - o.rear)
        around = np.minimum(o.front - ego.front, ego.rear - o.rear)
        front = np.minimum(o.front - ego.rear, ego.front - o.front)
        return np.minimum(aside, np.maximum(np.maximum(rear, around), front))

    def drives_slightly_faster(self, t: Traffic) -> Floats:
        """The ego is faster than o, but no more than a little."""
        return np.minimum(self.drives_faster(t), super().drives_slightly_faster(t))

    def brakes(self, t: Traffic) -> Floats:
        """(N,) the ego brakes."""
        return np.asarray(-t.ego.acceleration[:, 0])
