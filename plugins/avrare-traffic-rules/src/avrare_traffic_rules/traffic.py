"""One sample of traffic as the predicates see it: extents of the rectangles, lanes, speeds.

Arrays of the ego are (N, 1) and those of the others (N, V), so that predicates are plain arithmetic.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from avrare.driving import Road, Scene
from avrare.protocols import Bools, Floats, Signals

Extents = Callable[[Floats, Floats, Floats], tuple[Floats, Floats]]
"""(length, width, heading) to half the extent along and across the road."""


@dataclass(frozen=True)
class Bodies:
    """Vehicles as rectangles on the road; all fields (N, V).

    Attributes:
        x: Centre [m].
        y: Centre [m].
        heading: [rad].
        speed: [m/s].
        acceleration: [m/s^2].
        half_length: Half the extent along the road [m].
        half_width: Half the extent across the road [m].
        length: Of the rectangle [m].
        width: Of the rectangle [m].
    """

    x: Floats
    y: Floats
    heading: Floats
    speed: Floats
    acceleration: Floats
    half_length: Floats
    half_width: Floats
    length: Floats
    width: Floats

    @property
    def front(self) -> Floats:
        """Foremost x."""
        return self.x + self.half_length

    @property
    def rear(self) -> Floats:
        """Rearmost x."""
        return self.x - self.half_length


@dataclass(frozen=True)
class Traffic:
    """The ego, the others, and the road."""

    ego: Bodies
    others: Bodies
    road: Road


def bounding_box(length: Floats, width: Floats, heading: Floats) -> tuple[Floats, Floats]:
    """Half the extents of the rectangle itself."""
    cos, sin = np.abs(np.cos(heading)), np.abs(np.sin(heading))
    return 0.5 * (length * cos + width * sin), 0.5 * (length * sin + width * cos)


def read_traffic(signals: Signals, scene: Scene, chosen: Bools, extents: Extents) -> Traffic:
    """Traffic of one sample from the simulator's signals, with the ``chosen`` (V,) vehicles."""

    def bodies(who: str, columns: Bools | None, length: Floats, width: Floats) -> Bodies:
        fields = ("x", "y", "heading", "speed", "acceleration")
        x, y, heading, speed, acceleration = (signals[f"{who}_{name}"][:, columns] for name in fields)
        half_length, half_width = extents(length, width, heading)
        return Bodies(x, y, heading, speed, acceleration, half_length, half_width, length, width)

    return Traffic(
        # the index None gives the ego's (N,) a vehicle axis
        bodies("ego", None, np.array([scene.ego_length]), np.array([scene.ego_width])),
        bodies("others", chosen, scene.lengths[chosen], scene.widths[chosen]),
        scene.road,
    )
