"""Cut-ins in the time stepping of the European Commission's Joint Research Centre (JRC), many at once.

Cases on the edge of a crash hang on rounding, so that sums are taken in JRC's order.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from avrare.base import batch
from avrare.base.errors import UsageError
from avrare.protocols import Bools, Floats
from avrare_reference_drivers.config import TtcReading
from avrare_reference_drivers.drivers import CRITICAL_TTC, DRIVERS, Reaction, Situation

_STEP, _RATE = 0.1, 10.0
"""Time step [s], and steps per second."""
_LENGTH, _WIDTH, _OFFSET = 4.3, 1.9, 3.5
"""Size of both cars, and distance of their centres across when the other has reached its speed across [m]."""
_GAIN = 1.5 / _RATE
"""Gain of the other's speed across in a step before that [m/s]."""
_BOUNDS = {
    "ego_speed": (0.0, 150.0),
    "other_speed": (0.0, 150.0),
    "gap": (-1000.0, 1000.0),
    "lateral_speed": (0.0, 20.0),
}
"""Lowest and highest values of a cut-in [m/s, m]."""


@dataclass(frozen=True)
class _CutIns:
    row: NDArray[np.int64]
    ramp: NDArray[np.int64]  # steps in which the other gains its speed across
    moving: NDArray[np.int64]  # steps at that speed
    other_x: Floats  # after the ramp
    other_speed: Floats
    lateral_speed: Floats
    other_way: Floats  # sum of its speeds across since the ramp [m/s]
    ego_x: Floats
    speed: Floats
    acceleration: Floats
    reaction: Reaction

    def at(self, step: int) -> Situation:
        """Return the situation at a step, counted from the begin of the ramp."""
        since = step - self.ramp
        ramps = since < 0
        to_come = _GAIN * (self.ramp * (self.ramp - 1) - step * (step - 1)) / 2.0
        y = _OFFSET + np.where(ramps, to_come, -self.other_way) / _RATE
        approach = np.where(since <= self.moving, self.lateral_speed, 0.0)
        ahead = self.other_speed * since * _STEP + self.other_x - self.ego_x
        return Situation(
            speed=self.speed,
            other_speed=self.other_speed,
            ahead=ahead,
            gap=np.abs(ahead) - _LENGTH,
            side_gap=np.abs(y) - _WIDTH,
            approach=np.where(ramps, _GAIN * step, approach),
            acceleration=self.acceleration,
        )

    def advance(self, step: int, speed: Floats, reaction: Reaction) -> _CutIns:
        """Return the cars one step later, in which the ego has this speed."""
        moves = (step >= self.ramp) & (step < self.ramp + self.moving)
        return replace(
            self,
            other_way=self.other_way + np.where(moves, self.lateral_speed, 0.0),
            ego_x=self.ego_x + speed / _RATE,
            speed=speed,
            acceleration=(speed - self.speed) / _STEP,
            reaction=reaction,
        )


def cut_in(
    model: str,
    ego_speed: ArrayLike,
    other_speed: ArrayLike,
    gap: ArrayLike,
    lateral_speed: ArrayLike,
    ttc_reading: TtcReading | None = None,
) -> tuple[Bools, Floats]:
    """Drive cut-ins of two cars, 4.3 m long and 1.9 m wide, one of them driven by a reference driver.

    The arrays are broadcast against each other.

    Args:
        model: ``cc``, ``cc_lane``, ``reg157``, ``rss`` or ``fsm``.
        ego_speed: Speed of the driver, 0 or above [m/s].
        other_speed: Speed of the car that cuts in, 0 or above [m/s].
        gap: Free gap along the road when it has reached its speed across, 1.6 m beside the driver [m].
        lateral_speed: That speed, which it gains by 1.5 m/s^2 [m/s].
        ttc_reading: What becomes of a cut-in whose time to collision is above 2 s at overlap across.
            ``settled``: it ends without a crash; ``waits``: it continues. Default: settled for ``cc``, as in
            JRC's grids, and waits for the others.

    Returns:
        Whether the cars touch, and the closing speed then [m/s]: NaN where they do not, below 0 where the
        driver has become slower than the car beside it.

    Raises:
        UsageError: No driver has this name, or a number is not one of a cut-in.
    """
    driver = DRIVERS.get(model)
    if driver is None:
        raise UsageError(f"no reference driver is called {model!r}", f"choose one of {', '.join(DRIVERS)}")
    if ttc_reading is not None and ttc_reading not in get_args(TtcReading):
        raise UsageError(f"ttc_reading: {ttc_reading!r} is unknown", "choose settled or waits")
    settles = ttc_reading == "settled" or (ttc_reading is None and model == "cc")
    numbers = [np.asarray(values, dtype=float) for values in (ego_speed, other_speed, gap, lateral_speed)]
    for (name, (low, high)), values in zip(_BOUNDS.items(), numbers, strict=True):
        wrong = values[~((values >= low) & (values <= high))]
        if wrong.size:
            hint = f"give numbers from {low:g} to {high:g}"
            raise UsageError(f"{name}: {wrong[0]:g} is not in a cut-in", hint)
    shape = np.broadcast_shapes(*(array.shape for array in numbers))
    speed, other, free, lateral = (np.broadcast_to(array, shape).ravel() for array in numbers)
    cars = _start(speed, other, free, lateral, Reaction.start(driver, len(speed)))
    impact = np.full(len(cars.row), np.nan)
    steps = 350  # after the other has reached its speed across
    for step in range(steps + int(cars.ramp.max(initial=0))):
        seen = cars.at(step)
        braking, reaction = cars.reaction.advance(driver, driver.demand(seen), _STEP)
        later = cars.advance(step, np.maximum(seen.speed - braking * _STEP, 0.0), reaction)
        touching = (seen.gap < 0.0) & (seen.side_gap < 0.0)
        impact[cars.row[touching]] = seen.closing[touching]
        over = touching | (step >= steps + cars.ramp - 1) | _is_over(seen, later.speed)
        if settles:
            over |= (seen.ahead >= 0.0) & ~(seen.side_gap > 0.0) & (seen.ttc > CRITICAL_TTC)
        cars = batch.take(later, np.flatnonzero(~over)) if over.any() else later
        if not len(cars.row):
            break
    return ~np.isnan(impact).reshape(shape), impact.reshape(shape)


def _start(
    speed: Floats, other_speed: Floats, gap: Floats, lateral_speed: Floats, reaction: Reaction
) -> _CutIns:
    tenths = np.round(lateral_speed * 10.0)  # JRC's are multiples of 0.1, whose rounding lengthens some ramps
    lateral = np.where(np.abs(lateral_speed * 10.0 - tenths) < 1e-9, tenths * 0.1, lateral_speed)
    ramp = np.ceil(lateral / _GAIN).astype(np.int64)
    moving = np.zeros_like(ramp)
    moving[ramp > 0] = _OFFSET / _STEP // lateral[ramp > 0] + 1
    ego_x = np.zeros_like(speed)
    for step in range(int(ramp.max(initial=0))):
        ego_x -= np.where(step < ramp, speed / _RATE, 0.0)
    rest = np.zeros_like(speed)
    return _CutIns(
        np.arange(len(speed)),
        ramp,
        moving,
        gap + _LENGTH,
        other_speed,
        lateral,
        rest,
        ego_x,
        speed,
        rest,
        reaction,
    )


def _is_over(seen: Situation, speed: Floats) -> Bools:
    # no driver speeds up: these cars never meet again
    behind = (seen.ahead >= _LENGTH) & (speed <= seen.other_speed)
    passed = (seen.ahead <= -_LENGTH) & (speed >= seen.other_speed)
    return behind | passed
