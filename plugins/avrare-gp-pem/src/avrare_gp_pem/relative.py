"""Other vehicles as the ego sees them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from avrare.driving import World

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Relative:
    """Poses of the others in the frame of the ego: centre and heading of the ego at zero.

    Attributes:
        forward: (N, V) distance ahead [m].
        left: (N, V) distance to the left [m].
        heading: (N, V) heading minus the ego's [rad], not wrapped.
    """

    forward: Floats
    left: Floats
    heading: Floats

    @property
    def range(self) -> Floats:
        """(N, V) distance between centres [m]."""
        return np.sqrt(self.forward * self.forward + self.left * self.left)


def relative(world: World) -> Relative:
    """The others of ``world`` in the frame of its ego."""
    heading = world.ego.heading[:, None]
    dx = world.others.x - world.ego.x[:, None]
    dy = world.others.y - world.ego.y[:, None]
    cos, sin = np.cos(heading), np.sin(heading)
    return Relative(cos * dx + sin * dy, cos * dy - sin * dx, world.others.heading - heading)
