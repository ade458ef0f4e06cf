"""Recorded drives as arrays over time, with the signals that a simulator would give."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from avrare.driving import Road, Scene, Vehicles, World
from avrare.driving.geometry import Rectangle, signed_distance
from avrare.errors import UsageError
from avrare.protocols import Bools, Floats

FIELDS = ("x", "y", "heading", "speed", "acceleration")

ABSENT = {"x": -1e6, "y": -1e6, "heading": 0.0, "speed": 0.0, "acceleration": 0.0}
"""Where a vehicle is that is not there: standing far behind and far to the right, in no lane.

It is in front of nobody, beside nobody and closes in on nobody, so that no rule speaks of it, and unlike NaN
or infinity it leaves every predicate a number.
"""

_TAKEN = {"ego": "the ego", "others": "all vehicles but the ego"}
"""Names that no vehicle but the ego may have."""

_STANDING = 0.01
"""A vehicle never faster than this [m/s] is parked."""


@dataclass(frozen=True)
class Recording:
    """One drive, or any other signals over time.

    Attributes:
        source: Where it comes from, for messages.
        dt: Step [s].
        start: Time of sample 0 [s].
        signals: name -> (T, ...), the names of a driving simulator where there are vehicles.
        scene: Road, sizes and names, None without vehicles or road.
        names: Of the other vehicles.
    """

    source: str
    dt: float
    start: float
    signals: Mapping[str, NDArray[Any]]
    scene: Scene | None = None
    names: tuple[str, ...] = ()

    @property
    def samples(self) -> int:
        """T."""
        return len(next(iter(self.signals.values())))

    @property
    def times(self) -> Floats:
        """(T,) [s]."""
        return np.asarray(self.start + self.dt * np.arange(self.samples))

    def time(self, sample: int) -> float:
        """Time of a sample [s]."""
        return self.start + self.dt * sample

    def world(self, sample: int) -> World:
        """The vehicles at a sample, as one particle."""
        one = slice(sample, sample + 1)
        ego, others = (
            Vehicles(*(self.signals[f"{who}_{field}"][one] for field in FIELDS)) for who in ("ego", "others")
        )
        return World(np.array([sample]), ego, others, np.zeros(1))


@dataclass(frozen=True)
class Track:
    """One vehicle over time.

    Attributes:
        name: Of the vehicle.
        length: Of its rectangle [m].
        width: Of its rectangle [m].
        present: (T,) False where it was not recorded; the states there mean nothing.
        states: (5, T): x, y [m], heading [rad], speed [m/s], acceleration [m/s^2]; NaN in the last is
            filled with the change of speed since the sample before.
    """

    name: str
    length: float
    width: float
    present: Bools
    states: Floats

    def filled(self, dt: float) -> dict[str, Floats]:
        """Field -> (T,), without gaps."""
        values = dict(zip(FIELDS, self.states, strict=True))
        change = np.zeros(len(self.present))
        both = self.present[1:] & self.present[:-1]
        change[1:][both] = np.diff(values["speed"])[both] / dt
        given = values["acceleration"]
        values["acceleration"] = np.where(np.isnan(given), change, given)
        return {field: np.where(self.present, x, ABSENT[field]) for field, x in values.items()}


def assemble(
    source: str, dt: float, start: float, ego: Track, others: Sequence[Track], road: Road | None
) -> Recording:
    """The recording of some vehicles.

    Args:
        source: Where they come from.
        dt: Step [s].
        start: Time of the first sample [s].
        ego: The vehicle that rules are for; present at every sample.
        others: The other vehicles.
        road: Lanes; without them there is no scene and no rule, only signals.

    Raises:
        UsageError: Another vehicle has a name that formulas use in another sense.
    """
    for name in (other.name for other in others if other.name in _TAKEN):
        text = f"{source}: a vehicle beside the ego is called {name!r}"
        hint = f"formulas mean {_TAKEN[name]} by that: give the vehicle another name"
        raise UsageError(text, hint)
    signals = {f"ego_{field}": x for field, x in ego.filled(dt).items()}
    filled = [other.filled(dt) for other in others]
    for field in FIELDS:
        table = np.zeros((len(ego.present), len(others)))
        for v, values in enumerate(filled):
            table[:, v] = values[field]
        signals[f"others_{field}"] = table
    lengths, widths = (np.array([getattr(other, key) for other in others]) for key in ("length", "width"))
    signals |= _distances(signals, ego, lengths, widths)
    names = tuple(other.name for other in others)
    scene = None
    if road is not None:
        moving = np.array(
            [bool(np.any(np.abs(o.states[3][o.present]) > _STANDING)) for o in others], dtype=bool
        )
        scene = Scene(dt, road, ego.length, ego.width, names, lengths, widths, moving)
    return Recording(source, dt, start, signals, scene, names)


def _distances(
    signals: Mapping[str, Floats], ego: Track, lengths: Floats, widths: Floats
) -> dict[str, Floats]:
    """``distance`` (T, V) to each other vehicle and ``gap`` (T,), the least."""
    own = Rectangle(
        signals["ego_x"][:, None], signals["ego_y"][:, None], signals["ego_heading"][:, None],
        np.array(ego.length), np.array(ego.width),
    )  # fmt: skip
    theirs = Rectangle(signals["others_x"], signals["others_y"], signals["others_heading"], lengths, widths)
    distance = signed_distance(own, theirs)
    return {"distance": distance, "gap": distance.min(axis=1, initial=np.inf)}
