"""One sample of traffic as the predicates see it: extents of the rectangles, lanes, speeds.

Arrays of the ego are (N, 1) and those of the others (N, V), so that predicates are plain arithmetic.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from avrare.driving import Road, Scene
from avrare.protocols import Bools, Floats, Signals


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


def read_traffic(signals: Signals, scene: Scene, chosen: Bools) -> Traffic:
    """Traffic of one sample from the simulator's signals, with the ``chosen`` (V,) vehicles."""
    return Traffic(
        _bodies(signals, "ego", np.array([scene.ego_length]), np.array([scene.ego_width]), None),
        _bodies(signals, "others", scene.lengths[chosen], scene.widths[chosen], chosen),
        scene.road,
    )


def _bodies(signals: Signals, who: str, length: Floats, width: Floats, chosen: Bools | None) -> Bodies:
    fields = ("x", "y", "heading", "speed", "acceleration")
    values = [signals[f"{who}_{name}"] for name in fields]
    x, y, heading, speed, acceleration = [
        value[:, None] if chosen is None else value[:, chosen] for value in values
    ]
    cos, sin = np.abs(np.cos(heading)), np.abs(np.sin(heading))
    return Bodies(
        x, y, heading, speed, acceleration,
        half_length=0.5 * (length * cos + width * sin),
        half_width=0.5 * (length * sin + width * cos),
        length=length, width=width,
    )  # fmt: skip
