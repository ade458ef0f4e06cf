"""Counts of large errors, misses and runs of misses, in data and by a model."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from avrare.protocols import Bools, Floats
from avrare_gp_pem.runtime.observation_model import ObservationLaw
from avrare_gp_pem.runtime.student_t import student
from avrare_gp_pem.runtime.variant import FittedPem
from avrare_pem_training.persistence import (
    NEARBY,
    correlation_after,
    detection_bounds,
    pair_probability,
    track_pairs,
)
from avrare_pem_training.scores import AXIS_NAMES
from avrare_pem_training.table import DetectionTable, errors_in

LARGE_ERRORS = (
    *((0.0, 10.0, 0.5), (9.0, 18.0, 1.0), (0.0, 20.0, 1.75)),
    *((20.0, 40.0, 1.75), (40.0, 60.0, 3.0)),
)
"""Range from, range to [m], and the size [m] beyond which errors are counted."""


@dataclass(frozen=True)
class Count:
    """Count of events among rows.

    Attributes:
        what: The event.
        rows: Rows that could have been one.
        seen: Events in the data.
        own: Events that the model expects there.
    """

    what: str
    rows: int
    seen: int
    expected: float


def count_events(model: FittedPem, rows: DetectionTable) -> list[Count]:
    """Count large errors and misses by range, under the detector's law."""
    law, errors = model.clean.law(rows, 0.0), errors_in(model.clean.frame, rows)
    counts = []
    for axis, name in reversed(list(enumerate(AXIS_NAMES[model.clean.frame]))):
        for low, high, size in LARGE_ERRORS:
            band = rows.detected & (rows.range >= low) & (rows.range < high)
            seen = int((np.abs(errors[band, axis]) > size).sum())
            expected = float(chance_beyond(law, axis, size, band).sum())
            counts.append(Count(f"{name} > {size:g} m, {low:g}-{high:g} m", int(band.sum()), seen, expected))
    for low, high in ((0.0, 10.0), (10.0, 15.0), (15.0, 20.0), (20.0, 40.0), (40.0, 60.0)):  # ranges [m]
        band = (rows.range >= low) & (rows.range < high)
        seen, expected = int((~rows.detected[band]).sum()), float(law.miss[band].sum())
        counts.append(Count(f"missed, {low:g}-{high:g} m", int(band.sum()), seen, expected))
    return counts


def chance_beyond(law: ObservationLaw, axis: int, size: float, rows: Bools) -> Floats:
    """Return the probability that an error of a detection is larger than ``size`` [m], to either side."""
    scale, centre = law.scale[rows, axis], law.location[rows, axis]
    power = 1.0 if law.power is None else law.power[rows, axis]
    table, bound = student(law.dof[axis]), law.limit / scale
    end = table.upper_tail(bound, power)
    total = np.zeros(len(scale))
    for z in ((size - centre) / scale, (size + centre) / scale):
        tail = table.upper_tail(np.minimum(np.abs(z), bound), power)
        total += np.clip((np.where(z < 0, 1 - tail, tail) - end) / (1 - 2 * end), 0.0, 1.0)
    return total


@dataclass(frozen=True)
class AfterMiss:
    """Probability of a miss some time after a miss.

    Attributes:
        seconds: Time between both frames.
        pairs: Misses with a second frame.
        seen: Share of them that is missed again.
        anew: The same by the model with independent errors.
        lasting: The same with its measured persistence; NaN where it has none.
    """

    seconds: float
    pairs: int
    seen: float
    anew: float
    lasting: float


def misses_after_misses(model: FittedPem, rows: DetectionTable) -> list[AfterMiss]:
    """Return shares of misses after a miss, of vehicles within ``NEARBY``; none without tracks."""
    law, pairs = model.clean.law(rows, 0.0), track_pairs(rows)
    near = (rows.range[pairs.first] < NEARBY) & (rows.range[pairs.second] < NEARBY)
    pairs = pairs.take(np.flatnonzero(near & ~rows.detected[pairs.first]))
    bounds, missed, shares = detection_bounds(law), np.zeros(len(rows), bool), []
    for lag in (0.5, 1.0, 2.0, 4.0):  # seconds after a miss
        some = pairs.take(np.flatnonzero(np.abs(pairs.seconds - lag) < 0.05))  # as near to the lag [s]
        if not len(some.first):
            continue
        lasting = float("nan")
        if model.persistence is not None:
            correlation = correlation_after(model.persistence.detection, some.seconds)
            both = pair_probability(bounds, missed, some, correlation)  # what happened: two misses
            lasting = float((both / law.miss[some.first]).mean())
        again = float((~rows.detected[some.second]).mean())
        shares.append(AfterMiss(lag, len(some.first), again, float(law.miss[some.second].mean()), lasting))
    return shares
