"""Training data of the first model (``train.py``): annotated vehicles and what the detector made of them.

Two text files with one row per vehicle. Inputs: x (right), y (forward), yaw, length, width, height,
visibility category. Labels: detected, error in x, y and yaw (truth minus estimate), -1000 where undetected.

Cleaning, all of it needed to learn the detector and not the labelling:

* rows whose inputs occur twice are dropped but for the first;
* only vehicles more than ``oblique`` degrees off both axes of the ego are used. Detections were matched to
  vehicles by the overlap of boxes spanned by two opposite corners. For a vehicle parallel to an axis such a
  box has no area: half of them count as missed even at 10 m, and the errors of the others are cut off;
* errors of yaw are not modelled: many are flips by half a turn.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from avrare_gp_pem.clean import off_axis
from avrare_gp_pem.features import Box, features

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Rows:
    """Vehicles and their detections.

    Attributes:
        inputs: (n, 10) features.
        detected: (n,) booleans.
        errors: (n, 2) truth minus estimate along and across the vehicle [m]; NaN where missed.
    """

    inputs: Floats
    detected: NDArray[np.bool_]
    errors: Floats

    def take(self, index: NDArray[np.bool_] | slice) -> Rows:
        """A selection of the rows."""
        return Rows(self.inputs[index], self.detected[index], self.errors[index])


def read(inputs: Path, labels: Path, oblique: float) -> tuple[Rows, Rows]:
    """Cleaned training and test rows.

    Args:
        inputs: File of inputs.
        labels: File of labels.
        oblique: Rows nearer than this to an axis of the ego are dropped [degrees]; 0 keeps all.

    Returns:
        The first 80 % and the last 20 % of the rows: neighbours are frames of one scene, so that a random
        split would test on what it trained on.
    """
    x, y = np.loadtxt(inputs, ndmin=2), np.loadtxt(labels, ndmin=2)
    if x.shape[1:] != (7,) or y.shape != (len(x), 4):
        raise ValueError(f"expected 7 columns of inputs and 4 of labels, got {x.shape} and {y.shape}")
    _, first = np.unique(x, axis=0, return_index=True)
    first.sort()
    x, y = x[first], y[first]
    split = int(0.8 * len(x))
    keep = off_axis(x[:, 2]) >= oblique
    rows = to_rows(x, y)
    return rows.take(keep & (np.arange(len(x)) < split)), rows.take(keep & (np.arange(len(x)) >= split))


def to_rows(x: Floats, y: Floats) -> Rows:
    """Features and labels of raw columns."""
    detected = y[:, 0] == 1
    cos, sin = np.cos(x[:, 2]), np.sin(x[:, 2])
    errors = np.stack([cos * y[:, 1] + sin * y[:, 2], cos * y[:, 2] - sin * y[:, 1]], axis=-1)
    errors[~detected] = np.nan
    return Rows(features(Box(*x.T)), detected, errors)
