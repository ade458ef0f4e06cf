"""Noise on the rays: a normal law around the true distance, truncated to what a ray can read."""

from __future__ import annotations

import numpy as np
from scipy.special import ndtr, ndtri

from avrare.protocols import Floats


def disturbed(distances: Floats, normals: Floats, sd: float) -> Floats:
    """Readings that follow N(distance, sd^2) given that they are in [0, 1], by inversion of that law.

    Increasing in the normals and exact in both tails, so that rare numbers may be handed in, too.

    Args:
        distances: (...) true ones / range, in [0, 1].
        normals: (...) standard normal numbers.
        sd: Of the untruncated law, in units of the range; 0: no noise.
    """
    if sd == 0.0:
        return distances
    below, above = ndtr(-distances / sd), ndtr((distances - 1.0) / sd)
    within = 1.0 - below - above
    # From the nearer end: a probability next to 1 has lost its digits.
    lower = ndtri(below + within * ndtr(normals))
    upper = -ndtri(above + within * ndtr(-normals))
    read: Floats = distances + sd * np.where(normals < 0.0, lower, upper)
    return np.clip(read, 0.0, 1.0)
