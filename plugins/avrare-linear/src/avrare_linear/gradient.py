"""Gradients of log p from failing tapes (stl-ess, Eq. 33-36, corrected).

With x = mean + F z the density's logarithm has the derivative s in the mean, s = pinv(F)' z, and s s'F -
pinv(F)' in the factor F. Their mean over failing tapes is the gradient of log p, p times that the gradient of
p: Eq. 33 lacks the factor, which Eq. 37 puts back. How a parameter moves mean and factor comes from a complex
step (Squire and Trapp 1998), which has no cancellation.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from avrare.errors import UsageError
from avrare.protocols import Floats, System
from avrare_linear.gaussian import TrajectoryGaussian

_STEP = 1e-30
_TOLERANCE = 1e-7


@dataclass(frozen=True)
class Gradient:
    """Of log p.

    Attributes:
        mean: (T + 1, n) with respect to the mean of the trajectory.
        map: (T + 1, n, D) with respect to its map, a factor of the covariance.
    """

    mean: Floats
    map: Floats


@dataclass(frozen=True)
class Sensitivity:
    """How a parameter of P entries moves a trajectory's law.

    Attributes:
        mean: (P, T + 1, n).
        map: (P, T + 1, n, D).
    """

    mean: Floats
    map: Floats


def log_gradient(gaussian: TrajectoryGaussian, tapes: Floats, weights: Floats | None = None) -> Gradient:
    """The gradient of log p in the trajectory's law.

    Args:
        gaussian: Law of the signals that the formula reads.
        tapes: (F, T + 1, noise_size) that fail, a sample of the noise's law given failure.
        weights: (F,) that add up to 1; None: all the same.
    """
    factor = gaussian.map.reshape(-1, gaussian.map.shape[2])
    inverse = np.linalg.pinv(factor).T
    scores = tapes.reshape(len(tapes), -1) @ inverse.T
    share = np.full(len(tapes), 1.0 / len(tapes)) if weights is None else weights
    spread = scores.T @ (share[:, None] * scores)
    return Gradient(
        (share @ scores).reshape(gaussian.mean.shape),
        (spread @ factor - inverse).reshape(gaussian.map.shape),
    )


def sensitivity(
    build: Callable[[Any], System], parameter: Floats, steps: int, names: Sequence[str]
) -> Sensitivity:
    """Derivatives of a trajectory's law in a parameter.

    Args:
        build: The system of a parameter, which it must let be complex (``LinearSystem`` does).
        parameter: (P,).
        steps: T.
        names: Signals.
    """
    found = []
    for k in range(len(parameter)):
        moved = parameter.astype(np.complex128)
        moved[k] += 1j * _STEP
        found.append(TrajectoryGaussian.unchecked(build(moved), steps, names))
    return Sensitivity(
        np.stack([one.mean.imag / _STEP for one in found]), np.stack([one.map.imag / _STEP for one in found])
    )


def chain(gaussian: TrajectoryGaussian, gradient: Gradient, moves: Sensitivity) -> Floats:
    """The gradient (P,) of log p in the parameter.

    Raises:
        UsageError: The parameter moves a part of the trajectory that has no noise: no sample can tell what
            that does to p.
    """
    factor = gaussian.map.reshape(-1, gaussian.map.shape[2])
    mean = moves.mean.reshape(len(moves.mean), -1)
    spread = moves.map.reshape(len(mean), *factor.shape)
    noisy = factor @ np.linalg.pinv(factor)
    lost = np.concatenate([mean - mean @ noisy.T, (spread - noisy @ spread).reshape(len(mean), -1)], axis=1)
    scale = max(np.abs(mean).max(initial=0.0), np.abs(spread).max(initial=0.0))
    if np.abs(lost).max(initial=0.0) > _TOLERANCE * scale:
        raise UsageError(
            "the parameter moves signals in a direction without noise; the gradient cannot be had of samples",
            "give the start and the process noise of all states",
        )
    along = (gradient.mean * moves.mean).reshape(len(mean), -1).sum(axis=1)
    return np.asarray(along + (gradient.map * moves.map).reshape(len(mean), -1).sum(axis=1))
