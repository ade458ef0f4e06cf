"""Transitions of vehicles from one value to another, all particles at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from avrare.driving import Vehicles
from avrare.protocols import Bools, Floats
from avrare_openscenario.story import Transition

Integers = NDArray[np.int64]
_BENDS = {"step": 0.0, "linear": 0.0, "cubic": 6.0, "sinusoidal": 0.5 * np.pi**2}
"""Highest second derivative of a transition over change and square of the time."""
Record = TypeVar("Record", Vehicles, "Course")


@dataclass(frozen=True)
class Course:
    """Transitions under way, of one quantity of V vehicles in N particles.

    Attributes:
        action: (N, V) index of the action, -1: none.
        start: (N, V) value at its begin.
        target: (N, V) value at its end.
        clock: (N, V) time or way since its begin [s or m].
        span: (N, V) time or way that it takes.
        form: (N, V) index of its shape.
        by_way: (N, V) whether it goes by the way driven.
    """

    action: Integers
    start: Floats
    target: Floats
    clock: Floats
    span: Floats
    form: Integers
    by_way: Bools

    @classmethod
    def idle(cls, n: int, vehicles: int) -> Course:
        """Return courses without transitions."""
        shape = (n, vehicles)
        start, target, clock, span = np.zeros((4, *shape))
        form, by_way = np.zeros(shape, np.int64), np.zeros(shape, np.bool_)
        return cls(np.full(shape, -1), start, target, clock, span, form, by_way)

    def begin(
        self,
        action: int,
        vehicle: int,
        rows: Bools,
        start: Floats,
        target: Floats,
        span: Floats | float = np.inf,
        form: int = 0,
        by_way: bool = False,
    ) -> Course:
        """Return the courses after a vehicle begins a new one in some rows, endless without a span."""
        course = put(self, vehicle, rows, action=action, start=start, target=target, clock=0.0)
        return put(course, vehicle, rows, span=span, form=form, by_way=by_way)

    def stop(self, actions: Sequence[int], rows: Bools) -> Course:
        """Return the courses without some actions in some rows."""
        stopped = np.isin(self.action, list(actions)) & rows[:, None]
        return replace(self, action=np.where(stopped, -1, self.action))

    def carry_over(self, vehicle: int, before: float, after: float, side: float) -> Course:
        """Return the courses with the values of one vehicle measured along another line.

        Args:
            vehicle: Its index.
            before: One of its values.
            after: The same along the new line.
            side: 1 where the new line has the direction of the old one, -1 where it is opposite.
        """
        start, target = self.start[:, vehicle] - before, self.target[:, vehicle] - before
        return put(self, vehicle, True, start=after + side * start, target=after + side * target)

    def finish(self, vehicle: int, rows: Bools) -> Course:
        """Return the courses without those of one vehicle in some rows."""
        return put(self, vehicle, rows, action=-1)

    def advance(self, dt: float, way: Floats) -> tuple[Course, Floats, Floats]:
        """Return the courses a step later, the values there, and their change by second or metre."""
        clock = self.clock + np.where(self.by_way, way, dt)
        lasting = self.span > 0.0
        share = np.where(lasting, np.minimum(clock / np.where(lasting, self.span, 1.0), 1.0), 1.0)
        done, rate = _transition(self.form, share)
        value = np.where(share >= 1.0 - 1e-9, self.target, self.start + (self.target - self.start) * done)
        slope = np.where(lasting & (share < 1.0 - 1e-9), (self.target - self.start) * rate, 0.0)
        action = np.where(share >= 1.0 - 1e-9, -1, self.action)
        return replace(self, clock=clock, action=action), value, slope / np.where(lasting, self.span, 1.0)


def put(record: Record, vehicle: int, rows: Bools | bool, **values: Floats | float) -> Record:
    """Return vehicles or courses (N, V) after one vehicle gets other values in some rows."""
    changed = {name: np.array(getattr(record, name)) for name in values}
    for name, value in values.items():
        changed[name][:, vehicle] = np.where(rows, value, changed[name][:, vehicle])
    return replace(record, **changed)


def transition_span(transition: Transition, change: Floats, value: Floats) -> Floats:
    """Return the time or way that a transition takes."""
    if transition.form == "step":
        return np.zeros_like(change)
    with np.errstate(divide="ignore", invalid="ignore"):
        if transition.dimension == "rate":
            # highest rate of a transition over its mean rate
            peaks = {"step": 0.0, "linear": 1.0, "cubic": 1.5, "sinusoidal": 0.5 * np.pi}
            return np.where(change == 0.0, 0.0, peaks[transition.form] * np.abs(change / value))
        if transition.dimension == "curvature":
            return np.where(change == 0.0, 0.0, np.sqrt(_BENDS[transition.form] * np.abs(change) / value))
    return value


def _transition(form: Integers, share: Floats) -> tuple[Floats, Floats]:
    # Part of the change that is done, and its derivative.
    angle = np.pi * share
    smooth = share * share * (3.0 - 2.0 * share), 6.0 * share * (1.0 - share)
    wave = 0.5 - 0.5 * np.cos(angle), 0.5 * np.pi * np.sin(angle)
    done = np.select([form == 1, form == 2, form == 3], [share, smooth[0], wave[0]], 1.0)
    return done, np.select([form == 1, form == 2, form == 3], [np.ones_like(share), smooth[1], wave[1]], 0.0)
