"""Gradients of log p from failing tapes (stl-ess, Eq. 33-36, corrected).

With x = mean + F z the log-density has the derivative s = pinv(F)' z in the mean, and s s'F - pinv(F)' in the
factor F. Their mean over failing tapes is the gradient of log p; p times that is the gradient of p (Eq. 33
lacks the factor p, which Eq. 37 restores). The derivatives of mean and factor in a parameter come from a
complex step (Squire and Trapp 1998), which has no cancellation.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from avrare.base.errors import UsageError
from avrare.protocols import Floats, System
from avrare_linear.gaussian import TrajectoryGaussian


@dataclass(frozen=True)
class Gradient:
    """Gradient of log p in the distribution of the trajectory.

    Attributes:
        mean: (T + 1, n) derivative in the mean.
        map: (T + 1, n, D) derivative in the map, a factor of the covariance.
    """

    mean: Floats
    map: Floats


@dataclass(frozen=True)
class Sensitivity:
    """Derivatives of a trajectory's distribution in a parameter with P entries.

    Attributes:
        mean: (P, T + 1, n) derivatives of the mean.
        map: (P, T + 1, n, D) derivatives of the map.
    """

    mean: Floats
    map: Floats


def estimate_log_gradient(
    gaussian: TrajectoryGaussian, tapes: Floats, weights: Floats | None = None
) -> Gradient:
    """Estimate the gradient of log p in the trajectory's distribution (stl-ess, Eq. 33).

    Args:
        gaussian: Distribution of the signals that the formula reads.
        tapes: (F, T + 1, noise_size) failing tapes, a sample of the noise given failure.
        weights: (F,) weights that add up to 1; None: equal weights.
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


def estimate_log_hessian(
    gaussian: TrajectoryGaussian, tapes: Floats, derivatives: Sensitivity, weights: Floats | None = None
) -> Floats:
    """Estimate the Hessian (P, P) of log p in a parameter that moves the mean of the trajectory, linearly.

    With s = inv(Sigma) (x - mean), a second derivative of the log-density gives (stl-ess, Section V, note a):
    the covariance of J s over the failing tapes, less J inv(Sigma) J'.

    Args:
        gaussian: Distribution of the signals that the formula reads.
        tapes: (F, T + 1, noise_size) failing tapes, a sample of the noise given failure.
        derivatives: Derivatives J of the mean in the parameter; those of the map must be 0.
        weights: (F,) weights that add up to 1; None: equal weights.

    Raises:
        UsageError: The parameter changes the map, or moves the mean in a direction without noise.
    """
    factor = gaussian.map.reshape(-1, gaussian.map.shape[2])
    jacobian = derivatives.mean.reshape(len(derivatives.mean), -1)
    _refuse_without_noise(factor, jacobian, derivatives.map.reshape(len(jacobian), *factor.shape))
    if np.abs(derivatives.map).max(initial=0.0) > 0.0:
        text = "the Hessian is known for parameters that move the mean alone"
        raise UsageError(text, "such as mean, reference and feedforward")
    along = jacobian @ np.linalg.pinv(factor).T
    scores = tapes.reshape(len(tapes), -1) @ along.T
    share = np.full(len(tapes), 1.0 / len(tapes)) if weights is None else weights
    centred = scores - share @ scores
    return np.asarray(centred.T @ (share[:, None] * centred) - along @ along.T)


def compute_sensitivity(
    build: Callable[[NDArray[np.complex128]], System], parameter: Floats, steps: int, names: Sequence[str]
) -> Sensitivity:
    """Compute the derivatives of a trajectory's distribution in a parameter by complex steps.

    Args:
        build: Function from a parameter to its system, which must accept complex numbers.
        parameter: (P,) parameter.
        steps: T.
        names: Names of the signals.
    """
    distributions = []
    imaginary_step = 1e-30
    for k in range(len(parameter)):
        moved = parameter.astype(np.complex128)
        moved[k] += 1j * imaginary_step
        distributions.append(TrajectoryGaussian.from_affine(build(moved), steps, names))
    return Sensitivity(
        np.stack([distribution.mean.imag / imaginary_step for distribution in distributions]),
        np.stack([distribution.map.imag / imaginary_step for distribution in distributions]),
    )


def apply_chain_rule(gaussian: TrajectoryGaussian, gradient: Gradient, derivatives: Sensitivity) -> Floats:
    """Apply the chain rule: return the gradient (P,) of log p in the parameter.

    Raises:
        UsageError: The parameter changes a part of the trajectory without noise, whose effect on p samples
            cannot show.
    """
    factor = gaussian.map.reshape(-1, gaussian.map.shape[2])
    mean = derivatives.mean.reshape(len(derivatives.mean), -1)
    spread = derivatives.map.reshape(len(mean), *factor.shape)
    _refuse_without_noise(factor, mean, spread)
    along = (gradient.mean * derivatives.mean).reshape(len(mean), -1).sum(axis=1)
    return np.asarray(along + (gradient.map * derivatives.map).reshape(len(mean), -1).sum(axis=1))


def _refuse_without_noise(factor: Floats, mean: Floats, spread: Floats) -> None:
    noisy = factor @ np.linalg.pinv(factor)
    lost = np.concatenate([mean - mean @ noisy.T, (spread - noisy @ spread).reshape(len(mean), -1)], axis=1)
    scale = max(np.abs(mean).max(initial=0.0), np.abs(spread).max(initial=0.0))
    if np.abs(lost).max(initial=0.0) > 1e-7 * scale:
        raise UsageError(
            "the parameter changes signals in a direction without noise: samples do not give the gradient",
            "give initial covariance and process noise to all states",
        )
