"""The predicates as the published code of Innes and Ramamoorthy defines them, to compare with its numbers.

Lanes are bands of half their width, tested at five points of the body; the safe distance is one car length;
metres, metres per second and radians meet in one minimum, unscaled.
"""

from __future__ import annotations

import numpy as np

from avrare.protocols import Floats
from avrare_traffic_rules.config import Scales, TrafficRuleConfig
from avrare_traffic_rules.predicates import Predicates
from avrare_traffic_rules.traffic import Bodies, Traffic

_UNSCALED = Scales(longitudinal=1.0, lateral=1.0, speed=1.0, acceleration=1.0, heading=1.0)


class PublishedPredicates(Predicates):
    """The same names with the published meanings."""

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
