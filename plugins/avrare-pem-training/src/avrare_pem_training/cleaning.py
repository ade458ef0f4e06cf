"""Training and held-out rows from a table, without effects of the labelling.

* Of rows with the same box only the first stays, and no training row that occurs among the held-out ones.
* Some data sets match detections to annotations by the overlap of boxes that two opposite corners span along
  the axes of the ego. For a vehicle parallel to an axis this box has no area: up to half of them count as
  missed even at 10 m, and the errors of the others are truncated. ``find_artefact`` looks for this; where it
  is found, the detector is fitted to vehicles ``OBLIQUE`` degrees or more off both axes, and the labels as
  delivered to all.

The last fifth of the rows is held out, as a block: neighbouring rows are frames of one scene, so a random
split would test on scenes of the training rows.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from avrare.base.errors import UsageError
from avrare.protocols import Bools, Floats
from avrare_pem_training.ghost_log import GhostLog
from avrare_pem_training.table import BOX, DetectionTable

OBLIQUE = 10.0
"""Vehicles nearer than this to an axis of the ego may be affected by the artefact [degrees]."""
_MIN_GAP, _MIN_STANDARD_ERRORS = 0.05, 5.0  # loss of detections that counts as the artefact


@dataclass(frozen=True)
class Artefact:
    """Detection of vehicles along an axis of the ego, compared with oblique ones at the same range.

    Attributes:
        aligned: Detection rate within 1 degree of an axis, over bands of range below 50 m.
        oblique: Detection rate of vehicles ``OBLIQUE`` degrees or more off both axes, in the same bands with
            the same weights.
        standard_errors: Their difference in standard errors.
    """

    aligned: float
    oblique: float
    standard_errors: float

    @property
    def is_measured(self) -> bool:
        """True if there were enough vehicles of both kinds."""
        return not np.isnan(self.aligned)

    @property
    def present(self) -> bool:
        """True if the labels show the artefact."""
        return self.oblique - self.aligned > _MIN_GAP and self.standard_errors > _MIN_STANDARD_ERRORS


@dataclass(frozen=True)
class CleanedData:
    """Training rows and held-out rows.

    Attributes:
        train: Training rows, without duplicates.
        oblique: (n,) mask of training rows free of the artefact.
        test: Held-out rows as delivered, with duplicates.
        test_oblique: Mask of held-out rows free of duplicates and of the artefact.
        artefact: Result of the search for the artefact.
        has_artefact: True if the artefact is modelled.
        dropped: Number of training rows dropped as duplicates.
        ghosts: False detections of the first four fifths of the frames; None: the log has none.
        test_ghosts: Those of the rest.
    """

    train: DetectionTable
    oblique: Bools
    test: DetectionTable
    test_oblique: Bools
    artefact: Artefact
    has_artefact: bool
    dropped: int
    ghosts: GhostLog | None = None
    test_ghosts: GhostLog | None = None


@dataclass(frozen=True)
class _Needs:
    """Fewest rows from which a model can be fitted or scored."""

    rows: int
    detected: int
    missed: int

    def check(self, rows: DetectionTable, label: str, hint: str = "") -> None:
        """Raise a ``UsageError`` that says which rows are too few."""
        count, detected = len(rows), int(rows.detected.sum())
        if count < self.rows:
            raise UsageError(f"too few rows: {count} {label} where {self.rows} are needed", hint)
        if detected < self.detected or count - detected < self.missed:
            how_many = "all" if detected == count else "none" if detected == 0 else f"{detected}"
            needed = f"at least {self.detected} detected and {self.missed} missed vehicles are needed"
            raise UsageError(
                f"{how_many} of the {count} {label} are detected: nothing to learn from", hint or needed
            )


def off_axis(yaw: Floats) -> Floats:
    """Return the angle between a vehicle and the nearest axis of the ego, 0 to 45 [degrees]."""
    deviation: Floats = np.abs((np.degrees(yaw) + 45) % 90 - 45)
    return deviation


def clean(rows: DetectionTable, artefact: bool | None = None, ghosts: GhostLog | None = None) -> CleanedData:
    """Split the rows and clean them.

    Args:
        rows: Rows as delivered, in the order of recording.
        artefact: True if the labels have the artefact of matching; None: look for it in the training rows.
        ghosts: False detections of the log.

    Raises:
        UsageError: Too few rows, or too few detections or misses, to fit or to score.
    """
    held_out_share = 0.2
    split = int((1 - held_out_share) * len(rows))
    boxes = np.stack([getattr(rows, name) for name in BOX], axis=1)
    _, first, box = np.unique(boxes, axis=0, return_index=True, return_inverse=True)
    box = box.reshape(-1)
    index = np.arange(len(rows))
    held_out = np.zeros(len(first), bool)
    held_out[box[split:]] = True
    training = (index == first[box]) & ~held_out[box] & (index < split)
    train, test = rows.take(training), rows.take(slice(split, None))
    fewest = 200
    _Needs(fewest, 50, 5).check(train, "training rows, the first four fifths without duplicates,")
    _Needs(fewest // 5, 10, 1).check(test, "held-out rows, the last fifth,")
    artefact_test = find_artefact(train)
    present = artefact_test.present if artefact is None else artefact
    oblique = [off_axis(part.yaw) >= (OBLIQUE if present else 0.0) for part in (train, test)]
    first_test = np.zeros(len(test), bool)
    first_test[np.unique(boxes[split:], axis=0, return_index=True)[1]] = True
    test_oblique = oblique[1] & first_test
    if present:
        hint = "--artefact no fits one model to all rows"
        _Needs(fewest // 2, 50, 1).check(
            train.take(oblique[0]), "training rows off the axes of the ego", hint
        )
        _Needs(20, 10, 0).check(test.take(test_oblique), "held-out rows off the axes of the ego", hint)
    dropped = split - int(training.sum())
    false = (None, None) if ghosts is None else ghosts.split(1 - held_out_share)
    return CleanedData(train, oblique[0], test, test_oblique, artefact_test, present, dropped, *false)


def find_artefact(rows: DetectionTable) -> Artefact:
    """Compare detection of aligned and oblique vehicles, in bands of range with enough of both."""
    angle, distance = off_axis(rows.yaw), rows.range
    gap = variance = total = aligned = 0.0
    for low, high in pairwise((0.0, 10.0, 20.0, 30.0, 40.0, 50.0)):
        band = (distance >= low) & (distance < high)
        largest_aligned_angle = 1.0  # degrees
        along, off = (
            rows.detected[band & where] for where in (angle < largest_aligned_angle, angle >= OBLIQUE)
        )
        if min(len(along), len(off)) < 20:
            continue
        weight = float(len(along))
        gap += weight * (off.mean() - along.mean())
        aligned += weight * along.mean()
        variance += weight**2 * sum(_variance_of_mean(part) for part in (along, off))
        total += weight
    if not total:
        return Artefact(float("nan"), float("nan"), 0.0)
    return Artefact(aligned / total, (aligned + gap) / total, gap / np.sqrt(variance))


def _variance_of_mean(outcomes: Bools) -> float:
    rate = (outcomes.sum() + 1) / (len(outcomes) + 2)  # one of either outcome is added to keep it above zero
    return float(rate * (1 - rate) / len(outcomes))
