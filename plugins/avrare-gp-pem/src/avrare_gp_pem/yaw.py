"""Errors of yaw: flips by half a turn, and the rest. Kept and reported; no observation has a yaw yet.

A detector that sees a box and not its front guesses which end is which: a tenth of all detections are half a
turn off, and a single law of the error would be wrong everywhere. So flips are a Bernoulli variable of their
own, logistic in range, and what remains, the error up to half a turn, is Student-t with a scale linear in
range.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from avrare_gp_pem.student import student

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class YawLaw:
    """The law of the error of yaw.

    Attributes:
        flip: (2,) logit of a flip: at range 0, and per metre of range.
        scale: (2,) Student-t scale of the rest [rad]: at range 0, and per metre of range.
        dof: () its degrees of freedom.
    """

    flip: Floats
    scale: Floats
    dof: Floats

    def flip_probability(self, distance: Floats) -> Floats:
        """Probability that a detection at this range [m] is half a turn off."""
        return np.asarray(1 / (1 + np.exp(-(self.flip[0] + self.flip[1] * distance))))

    def log_density(self, error: Floats, distance: Floats) -> Floats:
        """Log density of an error of yaw [rad] in (-pi, pi]."""
        flipped, rest = split(error)
        flip = self.flip_probability(distance)
        scale = self.scale[0] + self.scale[1] * distance
        quarter = np.pi / 2 / scale
        density = student(float(self.dof)).truncated_log_density(rest / scale, quarter) - np.log(scale)
        return np.asarray(np.log(np.where(flipped, flip, 1 - flip)) + density)


def split(error: Floats) -> tuple[NDArray[np.bool_], Floats]:
    """Whether an error of yaw is nearer to half a turn than to none, and what remains, in [-pi/2, pi/2]."""
    wrapped = (error + np.pi) % (2 * np.pi) - np.pi
    return np.abs(wrapped) > np.pi / 2, np.asarray((wrapped + np.pi / 2) % np.pi - np.pi / 2)
