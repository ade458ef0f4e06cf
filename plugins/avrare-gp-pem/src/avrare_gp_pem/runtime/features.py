"""Inputs of fitted models: named columns computed from a vehicle's pose and size.

The training data's frame has x to the right and y forward, and its yaw is counter-clockwise from x: a vehicle
aligned with the ego has yaw pi/2. ``box_of`` maps a world to that frame, ``features`` a box to the columns
that a model file lists. Every column is a smooth or piecewise smooth function of pose and size:

* range, and its logarithm: a lidar's resolution falls with it; it explains most of both detection and error;
* aspect (yaw minus bearing), by cosine and sine of one and two turns: which side faces the sensor. Aspect
  instead of yaw, because a spinning lidar sees the aspect;
* bearing, likewise: a detector is not trained equally in all directions;
* reach: the greater of the distances to the side and ahead, and soft steps of it. Detectors crop their points
  to a square, and detection falls within 5 m of its edge, which no smooth function of range follows. The
  steps every 8 m let the fit find where the square ends; ``edge`` is the step at 51.2 m, PointPillar's;
* length, width, height, visibility category 1 to 4;
* yaw and spans: orientation of a box relative to the ego's *axes*, which no lidar knows. Those listed in
  ``AXES`` only imitate labels that were matched by axis-aligned boxes (see
  ``training/cleaning.py``).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from operator import attrgetter

import numpy as np

from avrare.protocols import Floats
from avrare_gp_pem.runtime.visibility import Relative

_STEPS = tuple(range(10, 90, 8))
_THIN = 0.02  # floor of a span inside its logarithm [m]
_NEAR = 0.1  # floor of the range inside its logarithm [m]
NAMES = (
    *("range", "cos_aspect", "sin_aspect", "cos_bearing", "sin_bearing", "edge"),
    *("length", "width", "height", "visibility"),
)
"""Columns of format-1 models, in their order."""
COMMON = (
    *("range", "log_range", "right", "forward", "abs_right", "abs_forward", "reach"),
    *(f"reach_{step}" for step in _STEPS),
    *(f"{part}_{turn}" for turn in ("aspect", "2aspect", "bearing", "2bearing") for part in ("cos", "sin")),
    *("length", "width", "height", "visibility"),
)
"""Columns that a detector may depend on."""
LITERAL = ("right", "forward", "yaw", "length", "width", "height", "visibility")
"""Columns of the model of the STL-AMS paper."""
AXES = ("cos_yaw", "sin_yaw", "cos_2yaw", "sin_2yaw", "log_span_right", "log_span_forward")
"""Columns that only the artefact of label matching depends on."""


@dataclass(frozen=True)
class Box:
    """Vehicle in the frame of the training data; every field has the same shape or broadcasts.

    Attributes:
        right: Centre to the right of the ego [m].
        forward: Centre ahead of the ego [m].
        yaw: Counter-clockwise from right [rad].
        length: Length [m].
        width: Width [m].
        height: Height [m].
        visibility: Category 1 to 4.
    """

    right: Floats
    forward: Floats
    yaw: Floats
    length: Floats
    width: Floats
    height: Floats
    visibility: Floats

    @cached_property
    def range(self) -> Floats:
        """Distance from the ego's centre [m]."""
        return np.sqrt(self.right * self.right + self.forward * self.forward)

    @cached_property
    def reach(self) -> Floats:
        """Maximum of the distances to the side and ahead [m]."""
        return np.maximum(np.abs(self.right), np.abs(self.forward))

    @cached_property
    def bearing(self) -> tuple[Floats, Floats]:
        """Cosine and sine of the direction of the centre."""
        return np.cos(self._bearing), np.sin(self._bearing)

    @cached_property
    def aspect(self) -> tuple[Floats, Floats]:
        """Cosine and sine of yaw minus bearing."""
        aspect = self.yaw - self._bearing
        return np.cos(aspect), np.sin(aspect)

    @cached_property
    def heading(self) -> tuple[Floats, Floats]:
        """Cosine and sine of the yaw."""
        return np.cos(self.yaw), np.sin(self.yaw)

    @cached_property
    def _bearing(self) -> Floats:
        return np.arctan2(self.forward, self.right)


Column = Callable[[Box], Floats]


def _step(at: float) -> Column:
    # half a vehicle's length [m]: a vehicle that straddles the edge is partly seen
    return lambda box: np.tanh((box.reach - at) / 3.0)


def _turns(name: str, pair: Callable[[Box], tuple[Floats, Floats]]) -> dict[str, Column]:
    return {
        f"cos_{name}": lambda box: pair(box)[0],
        f"sin_{name}": lambda box: pair(box)[1],
        f"cos_2{name}": lambda box: 2 * pair(box)[0] * pair(box)[0] - 1,
        f"sin_2{name}": lambda box: 2 * pair(box)[0] * pair(box)[1],
    }


COLUMNS: dict[str, Column] = {
    **{name: attrgetter(name) for name in ("range", "right", "forward", "reach")},
    "log_range": lambda box: np.log(np.maximum(box.range, _NEAR)),
    "abs_right": lambda box: np.abs(box.right),
    "abs_forward": lambda box: np.abs(box.forward),
    "edge": _step(51.2),  # half the side of the square that PointPillar sees on nuScenes [m]
    **{f"reach_{step}": _step(step) for step in _STEPS},
    "yaw": lambda box: np.arctan2(box.heading[1], box.heading[0]),
    **_turns("aspect", attrgetter("aspect")),
    **_turns("bearing", attrgetter("bearing")),
    **_turns("yaw", attrgetter("heading")),
    **{name: attrgetter(name) for name in ("length", "width", "height", "visibility")},
    "log_span_right": lambda box: np.log(box.length * np.abs(box.heading[0]) + _THIN),
    "log_span_forward": lambda box: np.log(box.width * np.abs(box.heading[1]) + _THIN),
}
"""Functions of a box, by column. Changing one changes every model that reads it."""


def box_of(seen: Relative, lengths: Floats, widths: Floats, height: float, visibility: Floats) -> Box:
    """Return the other vehicles in the data's frame; ``lengths`` and ``widths`` are (V,), the rest (N, V)."""
    return Box(
        right=-seen.left,
        forward=seen.forward,
        yaw=seen.heading + np.pi / 2,
        length=lengths,
        width=widths,
        height=np.full_like(lengths, height),
        visibility=visibility,
    )


def features(box: Box, names: Sequence[str] = NAMES) -> Floats:
    """Return (..., len(names)) columns of ``box``; a full turn of its yaw changes only rounding.

    Raises:
        KeyError: A name is not a column.
    """
    columns = [COLUMNS[name](box) for name in names]
    return np.stack(np.broadcast_arrays(*columns), axis=-1)
