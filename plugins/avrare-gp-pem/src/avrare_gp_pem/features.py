"""What the Gaussian processes read of a vehicle.

The training data's frame has x to the right and y forward, and its yaw is counter-clockwise from x: a
vehicle aligned with the ego has yaw pi/2. ``box_of`` maps a world to that frame, ``features`` a box to ten
numbers:

* range: resolution of a lidar falls with it; it explains most of both detection and error size;
* cosine and sine of the aspect (yaw minus bearing): which side of the vehicle faces the sensor;
* cosine and sine of the bearing: the detector was not trained equally in all directions;
* edge: how far inside or outside the square of 51.2 m on either axis that the detector crops its points to;
  detection falls from 0.7 to 0.02 within 5 m of it, which no smooth function of range and bearing follows;
* length, width, height: how much there is to hit;
* visibility category 1 to 4.

Aspect instead of yaw, because aspect is what a spinning lidar sees. It also makes vehicles aligned with the
ego, whose training rows are unusable (see ``data.py``), lie between usable rows instead of outside them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from avrare_gp_pem.relative import Relative

Floats = NDArray[np.float64]
_CROP = 51.2  # half the side of the square that PointPillar sees on nuScenes [m]
_EDGE = 3.0  # about half the length of a vehicle: one that lies across the edge is partly seen [m]
NAMES = (
    "range",
    "cos_aspect",
    "sin_aspect",
    "cos_bearing",
    "sin_bearing",
    "edge",
    "length",
    "width",
    "height",
    "visibility",
)


@dataclass(frozen=True)
class Box:
    """A vehicle in the frame of the training data; every field has the same shape or broadcasts.

    Attributes:
        right: Centre to the right of the ego [m].
        forward: Centre ahead of the ego [m].
        yaw: Counter-clockwise from right [rad].
        length: [m].
        width: [m].
        height: [m].
        visibility: Category 1 to 4.
    """

    right: Floats
    forward: Floats
    yaw: Floats
    length: Floats
    width: Floats
    height: Floats
    visibility: Floats


def box_of(seen: Relative, lengths: Floats, widths: Floats, height: float, visibility: Floats) -> Box:
    """The others in the data's frame; ``lengths`` and ``widths`` (V,), the rest (N, V)."""
    return Box(
        right=-seen.left,
        forward=seen.forward,
        yaw=seen.heading + np.pi / 2,
        length=lengths,
        width=widths,
        height=np.full_like(lengths, height),
        visibility=visibility,
    )


def features(box: Box) -> Floats:
    """(..., 10) inputs in the order of ``NAMES``; unchanged when yaw changes by a full turn."""
    bearing = np.arctan2(box.forward, box.right)
    aspect = box.yaw - bearing
    columns = (
        np.sqrt(box.right * box.right + box.forward * box.forward),
        np.cos(aspect),
        np.sin(aspect),
        np.cos(bearing),
        np.sin(bearing),
        np.tanh((np.maximum(np.abs(box.right), np.abs(box.forward)) - _CROP) / _EDGE),
        box.length,
        box.width,
        box.height,
        box.visibility,
    )
    return np.stack(np.broadcast_arrays(*columns), axis=-1)
