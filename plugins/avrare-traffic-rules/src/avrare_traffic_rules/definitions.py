"""The two sets of meanings that a rule may be read with: ``recommended`` and ``published``.

The published ones are those of the code of Innes and Ramamoorthy, to compare with its numbers. Lanes are
bands of half their width, tested at five points of the body; front, rear and sides are the middles of the
rectangle's edges; the safe distance is one car length; metres, m/s and radians meet in one minimum, unscaled.
"""

from __future__ import annotations

import numpy as np

from avrare.driving import Road
from avrare.protocols import Floats
from avrare_traffic_rules.predicates import distances, motion, places
from avrare_traffic_rules.traffic import Bodies, bounding_box, overlap
from avrare_traffic_rules.vocabulary import Definitions, Setting, named, predicate

RECOMMENDED = Definitions(
    named(vars(places)) | named(vars(motion)) | named(vars(distances)), bounding_box, overlap, scaled=True
)


def edge_middles(length: Floats, width: Floats, heading: Floats) -> tuple[Floats, Floats]:
    """From the centre to the middle of the front edge along the road, of the left edge across it."""
    return 0.5 * length * np.cos(heading), 0.5 * width * np.cos(heading)


def inner_half(bodies: Bodies, road: Road) -> Floats:
    """(L, ...) how far a body is in each lane's inner half, by its centre or the middle of an edge."""
    along = 0.5 * bodies.length * np.sin(bodies.heading)
    across = 0.5 * bodies.width * np.cos(bodies.heading)
    points = np.stack([bodies.y + d for d in (0.0 * along, along, -along, across, -across)])
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
    | named({one.name: one for one in (keeps_safe_distance, left_of, drives_slightly_faster)}),
    edge_middles,
    inner_half,
    scaled=False,
)
DEFINITIONS = {"recommended": RECOMMENDED, "published": PUBLISHED}
