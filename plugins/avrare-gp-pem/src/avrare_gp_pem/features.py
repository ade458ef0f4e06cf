"""What a fitted model reads of a vehicle: columns of numbers, each with a name that the model's file lists.

The training data's frame has x to the right and y forward, and its yaw is counter-clockwise from x: a
vehicle aligned with the ego has yaw pi/2. ``box_of`` maps a world to that frame, ``features`` a box to the
columns that a model asks for. Every column is a smooth or piecewise smooth function of pose and size:

* range, and its logarithm: resolution of a lidar falls with it; it explains most of both detection and error;
* aspect (yaw minus bearing), by cosine and sine of one and two turns: which side faces the sensor. Aspect
  instead of yaw, because aspect is what a spinning lidar sees;
* bearing, likewise: a detector was not trained equally in all directions;
* reach: the greater of the distances to the side and ahead, and soft steps of it. Detectors crop their points
  to a square, and detection falls within 5 m of its edge, which no smooth function of range follows. The
  steps every 8 m leave it to the fit where the square ends; ``edge`` is the step at 51.2 m, PointPillar's;
* length, width, height, visibility category 1 to 4;
* yaw and spans: how a box lies to the ego's *axes*. No lidar knows these axes: the columns serve only to
  imitate labels that were matched by axis-aligned boxes (see ``clean.py``), and ``AXES`` lists them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from avrare_gp_pem.relative import Relative

Floats = NDArray[np.float64]
_CROP = 51.2  # half the side of the square that PointPillar sees on nuScenes [m]
_SOFT = 3.0  # about half the length of a vehicle: one that lies across an edge is partly seen [m]
_STEPS = tuple(range(10, 90, 8))
_THIN = 0.02  # a span below this is as good as none [m]
_NEAR = 0.1  # where the logarithm of the range is cut off [m]
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
"""The columns of the first models, in their order."""
COMMON = (
    *("range", "log_range", "right", "forward", "abs_right", "abs_forward", "reach"),
    *(f"reach_{step}" for step in _STEPS),
    *(f"{part}_{turn}" for turn in ("aspect", "2aspect", "bearing", "2bearing") for part in ("cos", "sin")),
    *("length", "width", "height", "visibility"),
)
"""The columns that a detector may depend on."""
AXES = ("cos_yaw", "sin_yaw", "cos_2yaw", "sin_2yaw", "log_span_right", "log_span_forward")
"""The columns that only an artefact of box matching depends on."""


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

    @cached_property
    def range(self) -> Floats:
        """Distance from the ego's centre [m]."""
        return np.sqrt(self.right * self.right + self.forward * self.forward)

    @cached_property
    def reach(self) -> Floats:
        """The greater of the distances to the side and ahead [m]."""
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
    return lambda box: np.tanh((box.reach - at) / _SOFT)


def _turns(name: str, pair: Callable[[Box], tuple[Floats, Floats]]) -> dict[str, Column]:
    """Cosine and sine of an angle and of its double."""
    return {
        f"cos_{name}": lambda box: pair(box)[0],
        f"sin_{name}": lambda box: pair(box)[1],
        f"cos_2{name}": lambda box: 2 * pair(box)[0] * pair(box)[0] - 1,
        f"sin_2{name}": lambda box: 2 * pair(box)[0] * pair(box)[1],
    }


COLUMNS: dict[str, Column] = {
    "range": lambda box: box.range,
    "log_range": lambda box: np.log(np.maximum(box.range, _NEAR)),
    "right": lambda box: box.right,
    "forward": lambda box: box.forward,
    "abs_right": lambda box: np.abs(box.right),
    "abs_forward": lambda box: np.abs(box.forward),
    "reach": lambda box: box.reach,
    "edge": _step(_CROP),
    **{f"reach_{step}": _step(step) for step in _STEPS},
    **_turns("aspect", lambda box: box.aspect),
    **_turns("bearing", lambda box: box.bearing),
    **_turns("yaw", lambda box: box.heading),
    "length": lambda box: box.length,
    "width": lambda box: box.width,
    "height": lambda box: box.height,
    "visibility": lambda box: box.visibility,
    "log_span_right": lambda box: np.log(box.length * np.abs(box.heading[0]) + _THIN),
    "log_span_forward": lambda box: np.log(box.width * np.abs(box.heading[1]) + _THIN),
}
"""Name of a column -> its values. Changing one changes every model that reads it."""


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


def features(box: Box, names: Sequence[str] = NAMES) -> Floats:
    """(..., len(names)) columns of ``box``; unchanged, but for rounding, when yaw changes by a full turn.

    Raises:
        KeyError: There is no such column.
    """
    columns = [COLUMNS[name](box) for name in names]
    return np.stack(np.broadcast_arrays(*columns), axis=-1)
