"""Traffic of one sample: rectangles, lanes and speeds of the ego and the other vehicles."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from avrare.base.errors import UsageError
from avrare.driving import Road, Scene
from avrare.driving.lanes import lane_overlap
from avrare.protocols import Bools, Floats, Signals

Extents = Callable[[Floats, Floats, Floats], tuple[Floats, Floats]]
"""Function (length, width, heading) -> half the extent along and across the road."""


@dataclass(frozen=True)
class Bodies:
    """Vehicles as rectangles on the road; all fields broadcast to the shape of ``x``, except for ``lanes``.

    Attributes:
        x: Centre [m].
        y: Centre [m].
        heading: [rad].
        speed: [m/s].
        acceleration: [m/s^2].
        half_length: Half the extent along the road [m].
        half_width: Half the extent across the road [m].
        length: Length of the rectangle [m].
        width: Width of the rectangle [m].
        lanes: (L, ...) how far it reaches into each lane [m]; negative outside.
        number: Index among the other vehicles; -1 for the ego.
        way: Way through an intersection, by the signal ``others_way``; -1 where it is not known.
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
    lanes: Floats
    number: NDArray[np.int64]
    way: Floats

    @property
    def front(self) -> Floats:
        """Foremost x."""
        return self.x + self.half_length

    @property
    def rear(self) -> Floats:
        """Rearmost x."""
        return self.x - self.half_length

    def view(self, index: object) -> Bodies:
        """Select or add trailing axes by ``index``, which begins with ``...``."""
        return Bodies(*(getattr(self, field.name)[index] for field in dataclasses.fields(self)))


Lanes = Callable[[Bodies, Road], Floats]
"""Function (bodies without ``lanes``, road) -> (L, ...) how far they reach into each lane [m]."""


@dataclass(frozen=True)
class Traffic:
    """Vehicles of one sample.

    Attributes:
        ego: The ego, fields (N,).
        others: The vehicles that formulas quantify over, fields (N, V).
        every: All other vehicles, fields (N, W).
        names: Names of all other vehicles.
        views: Cache of arguments.
    """

    ego: Bodies
    others: Bodies
    every: Bodies
    names: tuple[str, ...]
    views: dict[tuple[str, int, int], Bodies] = field(default_factory=dict)

    def arguments(self, names: Sequence[str]) -> tuple[tuple[Bodies, ...], tuple[int, ...]]:
        """Return the arguments of a predicate, shaped to broadcast, and the shape of its values.

        Args:
            names: Names of its arguments: ``ego``, a vehicle's name, or ``others``, each of which adds an
                axis.
        """
        axes = [name == "others" for name in names]
        total = sum(axes)
        bodies = (self._broadcastable(name, sum(axes[:i]), total) for i, name in enumerate(names))
        return tuple(bodies), self.ego.x.shape + self.others.x.shape[1:] * total

    def _broadcastable(self, name: str, before: int, total: int) -> Bodies:
        key = (name, before, total)
        if key not in self.views:
            after = [None] * (total - before - 1)
            if name == "others":
                self.views[key] = self.others.view((..., *[None] * before, slice(None), *after))
            else:
                bodies = self.ego if name == "ego" else self.every.view((..., self.names.index(name)))
                self.views[key] = bodies.view((..., *[None] * total))
        return self.views[key]


def bounding_box(length: Floats, width: Floats, heading: Floats) -> tuple[Floats, Floats]:
    """Return half the extents of the bounding box of a rectangle."""
    cos, sin = np.abs(np.cos(heading)), np.abs(np.sin(heading))
    return 0.5 * (length * cos + width * sin), 0.5 * (length * sin + width * cos)


def overlap(bodies: Bodies, road: Road) -> Floats:
    """Return (L, ...) the overlap of the bounding box and each lane [m]."""
    return lane_overlap(road, bodies.x, bodies.y, bodies.half_length, bodies.half_width)


def read_lights(signals: Signals, road: Road) -> tuple[Floats, ...]:
    """Return the colours (N,) of the lights of a road at one sample.

    Raises:
        UsageError: A signal is missing.
    """
    names = [f"light_{k}" for k in range(len(road.light_lines))]
    if missing := [name for name in names if name not in signals]:
        raise UsageError(
            f"the road has a traffic light, but not its signal {missing[0]!r}",
            "it is 0 for green, 1 for yellow and 2 for red at each sample",
        )
    return tuple(signals[name] for name in names)


def read_traffic(signals: Signals, scene: Scene, chosen: Bools, extents: Extents, lanes: Lanes) -> Traffic:
    """Read the traffic of one sample from the simulator's signals.

    Raises:
        UsageError: A signal is missing.
    """

    def bodies(who: str, length: Floats, width: Floats, number: NDArray[np.int64]) -> Bodies:
        motion = ("x", "y", "heading", "speed", "acceleration")
        try:
            x, y, heading, speed, acceleration = (signals[f"{who}_{name}"] for name in motion)
        except KeyError as error:
            hint = f"they read {', '.join(f'{who}_{name}' for name in motion)}"
            raise UsageError(f"traffic rules need the signal {error}, which does not exist", hint) from error
        half_length, half_width = extents(length, width, heading)
        way = signals.get(f"{who}_way", np.full(number.shape, -1.0))
        plain = Bodies(
            x, y, heading, speed, acceleration, half_length, half_width, length, width, x[None], number, way
        )
        return dataclasses.replace(plain, lanes=lanes(plain, scene.road))

    # the particle axis of sizes and numbers has length 1
    ego = bodies("ego", np.array([scene.ego_length]), np.array([scene.ego_width]), np.array([-1]))
    all_others = bodies("others", scene.lengths[None], scene.widths[None], np.arange(len(scene.names))[None])
    others = all_others if chosen.all() else all_others.view((..., chosen))
    return Traffic(ego, others, all_others, scene.names)
