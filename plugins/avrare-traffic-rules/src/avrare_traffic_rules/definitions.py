"""Two sets of meanings of predicates: ``recommended`` and ``published``.

The published ones are those of the code of Innes and Ramamoorthy, for comparison with its numbers. Lanes are
bands of half their width, tested at five points of the body; front, rear and sides are the midpoints of the
rectangle's edges; the safe distance is one car length; metres, m/s and radians are compared unscaled.
"""

from __future__ import annotations

import numpy as np

from avrare.driving import Road
from avrare.driving.lanes import lane_borders, lane_exists
from avrare.protocols import Floats
from avrare_traffic_rules import intersections, positions, predicates
from avrare_traffic_rules.traffic import Bodies, bounding_box, overlap
from avrare_traffic_rules.vocabulary import Definitions, Setting, find_predicates, predicate

RECOMMENDED = Definitions(
    find_predicates(vars(positions))
    | find_predicates(vars(predicates))
    | find_predicates(vars(intersections)),
    bounding_box,
    overlap,
    scaled=True,
)

PLAIN = frozenset({"distance", "speed", "acceleration", "other_than"})
WITHOUT_LANES = PLAIN | frozenset(find_predicates(vars(intersections)))
"""Names of the predicates that mean something in the plane, where a road has no lanes."""


def edge_midpoints(length: Floats, width: Floats, heading: Floats) -> tuple[Floats, Floats]:
    """Return the offsets of the front edge's midpoint along the road and the left edge's across it."""
    return 0.5 * length * np.cos(heading), 0.5 * width * np.cos(heading)


def inner_half(bodies: Bodies, road: Road) -> Floats:
    """Return (L, ...) how far a body's centre or an edge's midpoint is inside each lane's inner half."""
    along = 0.5 * bodies.length * np.sin(bodies.heading)
    across = 0.5 * bodies.width * np.cos(bodies.heading)
    points = np.stack([bodies.y + d for d in (0.0 * along, along, -along, across, -across)])
    if road.lanes:
        right, left = lane_borders(road, bodies.x)
        nearest = np.abs(points[:, None] - 0.5 * (right + left)).min(axis=0)
        return np.where(lane_exists(road, bodies.x), 0.25 * (left - right) - nearest, -np.inf)
    centres = np.array(road.lane_centres).reshape(-1, *[1] * bodies.y.ndim)
    nearest = np.abs(points[:, None] - centres).min(axis=0)
    return np.asarray(0.25 * road.lane_width - nearest)


@predicate("longitudinal")
def keeps_safe_distance(s: Setting, a: Bodies, b: Bodies) -> Floats:
    """A is at least one length of b behind it."""
    return b.rear - a.front - b.length


@predicate("mixed")
def left_of(s: Setting, a: Bodies, b: Bodies) -> Floats:
    """The rear of a, all of b, or the front of a is beside the other; a is to the left."""
    aside = a.y - a.half_width - b.y - b.half_width
    rear = np.minimum(a.rear - b.rear, b.front - a.rear)
    around = np.minimum(a.front - b.front, b.rear - a.rear)
    front = np.minimum(a.front - b.rear, b.front - a.front)
    return np.minimum(aside, np.maximum(np.maximum(rear, around), front))


@predicate("speed")
def drives_slightly_faster(s: Setting, a: Bodies, b: Bodies) -> Floats:
    """A is faster than b, but by less than ``slightly_faster``."""
    return np.minimum(a.speed - b.speed, s.parameters.slightly_faster - (a.speed - b.speed))


PUBLISHED = Definitions(
    dict(RECOMMENDED.predicates)
    | find_predicates({rule.name: rule for rule in (keeps_safe_distance, left_of, drives_slightly_faster)}),
    edge_midpoints,
    inner_half,
    scaled=False,
)
DEFINITIONS = {"recommended": RECOMMENDED, "published": PUBLISHED}
