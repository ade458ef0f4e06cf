"""From a table to training and held-out rows; what belongs to the labelling and not to the detector goes.

* Rows whose boxes occur twice are dropped but for the first, and training rows that occur among the held-out
  ones.
* Some data sets match detections to annotations by the overlap of boxes that two opposite corners span along
  the axes of the ego. For a vehicle parallel to an axis such a box has no area: up to half of them count as
  missed even at 10 m, and the errors of the others are cut off. ``artefact`` looks for this; where it is
  found, the detector is learnt from vehicles ``OBLIQUE`` degrees or more off both axes, and the labels as
  delivered from all.
* Errors of yaw near half a turn are flips, which ``yaw.py`` models apart from the rest.

The last fifth of the rows is held out, as a block: neighbours are frames of one scene, so that a random split
would test on what it trained on.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from avrare.errors import UsageError
from avrare_gp_pem.table import BOX, Table

Floats = NDArray[np.float64]
OBLIQUE = 10.0
"""Vehicles nearer than this to an axis of the ego are touched by the artefact [degrees]."""
HELD_OUT = 0.2
LEAST_ROWS = 200
_ALIGNED = 1.0
_BANDS = (0.0, 10.0, 20.0, 30.0, 40.0, 50.0)
_TELLING = 0.05, 5.0  # an artefact takes so much of the detections, in so many standard errors


@dataclass(frozen=True)
class Artefact:
    """How much rarer vehicles along an axis of the ego are detected than oblique ones at the same range.

    Attributes:
        aligned: Detection rate within 1 degree of an axis, over bands of range below 50 m.
        oblique: That of vehicles ``OBLIQUE`` degrees or more off both, in the same bands with the same
            weights.
        sure: Their difference in standard errors.
    """

    aligned: float
    oblique: float
    sure: float

    @property
    def known(self) -> bool:
        """Whether there were enough vehicles of both kinds to tell."""
        return not np.isnan(self.aligned)

    @property
    def present(self) -> bool:
        """Whether labels were matched by boxes without area, as far as one can tell."""
        return self.oblique - self.aligned > _TELLING[0] and self.sure > _TELLING[1]


@dataclass(frozen=True)
class Cleaned:
    """Rows to fit to and rows to score on.

    Attributes:
        train: All training rows, without duplicates.
        oblique: (n,) which of them are free of the artefact.
        test: Held-out rows as delivered, duplicates too.
        test_oblique: Which of them are no duplicates and free of the artefact.
        artefact: What was found.
        has_artefact: Whether it is taken for one.
        dropped: Training rows that were dropped as duplicates.
    """

    train: Table
    oblique: NDArray[np.bool_]
    test: Table
    test_oblique: NDArray[np.bool_]
    artefact: Artefact
    has_artefact: bool
    dropped: int


def off_axis(yaw: Floats) -> Floats:
    """Angle between a vehicle and the nearest axis of the ego, 0 to 45 [degrees]."""
    return np.abs((np.degrees(yaw) + 45) % 90 - 45)  # type: ignore[no-any-return]


def clean(rows: Table, artefact: bool | None = None) -> Cleaned:
    """Split and clean.

    Args:
        rows: As delivered, in the order of recording.
        artefact: Whether the labels have the artefact of matching; None: look for it in the training rows.

    Raises:
        UsageError: Too few rows, or too few detections or misses, to fit or to score.
    """
    split = int((1 - HELD_OUT) * len(rows))
    boxes = np.stack([getattr(rows, name) for name in BOX], axis=1)
    _, first, of = np.unique(boxes, axis=0, return_index=True, return_inverse=True)
    index = np.arange(len(rows))
    original = index == first[of.reshape(-1)]
    held_out = np.zeros(len(first), bool)
    held_out[of.reshape(-1)[split:]] = True
    kept = original & ~held_out[of.reshape(-1)] & (index < split)
    train, test = rows.take(kept), rows.take(slice(split, None))
    _check(train, "training rows, the first four fifths without duplicates,", LEAST_ROWS, 50, 5)
    _check(test, "held-out rows, the last fifth,", LEAST_ROWS // 5, 10, 1)
    found = artefact_of(train)
    present = found.present if artefact is None else artefact
    apart = [off_axis(part.yaw) >= (OBLIQUE if present else 0.0) for part in (train, test)]
    test_oblique = apart[1] & (_first_in(boxes[split:]))
    if present:
        _check(train.take(apart[0]), "training rows off the axes of the ego", LEAST_ROWS // 2, 50, 1)
        _check(test.take(test_oblique), "held-out rows off the axes of the ego", 20, 10, 0)
    return Cleaned(train, apart[0], test, test_oblique, found, present, split - int(kept.sum()))


def artefact_of(rows: Table) -> Artefact:
    """Detection of aligned and oblique vehicles, in bands of range where there are enough of both."""
    angle, distance = off_axis(rows.yaw), rows.box.range
    gap = variance = total = aligned = 0.0
    for low, high in pairwise(_BANDS):
        band = (distance >= low) & (distance < high)
        near, far = (rows.detected[band & where] for where in (angle < _ALIGNED, angle >= OBLIQUE))
        if min(len(near), len(far)) < 20:
            continue
        weight = float(len(near))
        gap += weight * (far.mean() - near.mean())
        aligned += weight * near.mean()
        variance += weight**2 * sum(_variance(part) for part in (near, far))
        total += weight
    if not total:
        return Artefact(float("nan"), float("nan"), 0.0)
    return Artefact(aligned / total, (aligned + gap) / total, gap / np.sqrt(variance))


def _variance(outcomes: NDArray[np.bool_]) -> float:
    """Of the mean of Bernoulli outcomes, with one of either added so that it is never zero."""
    rate = (outcomes.sum() + 1) / (len(outcomes) + 2)
    return float(rate * (1 - rate) / len(outcomes))


def _first_in(boxes: Floats) -> NDArray[np.bool_]:
    first = np.zeros(len(boxes), bool)
    first[np.unique(boxes, axis=0, return_index=True)[1]] = True
    return first


def _check(rows: Table, what: str, least: int, detected: int, missed: int) -> None:
    """Raise ``UsageError`` unless there are so many rows, so many of them detected and so many missed."""
    count, seen = len(rows), int(rows.detected.sum())
    hint = "--artefact no fits one law to all rows" if "off the axes" in what else ""
    if count < least:
        raise UsageError(f"too few rows: {count} {what} where {least} are needed", hint)
    if seen < detected or count - seen < missed:
        how_many = "all" if seen == count else "none" if seen == 0 else f"{seen}"
        needed = f"at least {detected} detected and {missed} missed vehicles are needed"
        raise UsageError(
            f"{how_many} of the {count} {what} are detected: nothing to learn from", hint or needed
        )
