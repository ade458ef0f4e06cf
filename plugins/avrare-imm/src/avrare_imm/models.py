"""Sets of linear motion models, and their positions some steps ahead."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from avrare.protocols import Floats

STOP, GO = 0.001, 0.002
"""Probabilities that a vehicle that moves stands one step later, and the other way round."""
_STANDING_NOISE = 0.05
"""Variance of a step of a standing vehicle over a measurement's: a new one weighs 0.2, as errors last."""


@dataclass(frozen=True)
class ModelSet:
    """M models x+ = F x + E + noise of n states, the first p of which are measured.

    Attributes:
        dynamics: (M, n, n) F.
        offset: (M, n) E.
        noise: (M, n, n) covariance of the process noise.
        measurement_variance: (p,) of the independent measurement errors; p is 1 or 2.
        transition: (M, M) probability of mode j (column) after mode i (row).
    """

    dynamics: Floats
    offset: Floats
    noise: Floats
    measurement_variance: Floats
    transition: Floats


@dataclass(frozen=True)
class Horizon:
    """Position after k = 0..H steps as an affine function of the state, for each model.

    Attributes:
        weight: (H + 1, M, n) first row of F^k.
        offset: (H + 1, M) first entry of (I + F + ... + F^(k-1)) E [m].
    """

    weight: Floats
    offset: Floats


def longitudinal_models(
    kinds: Sequence[str], dt: float, noise: float, variances: Sequence[float], stay: float
) -> ModelSet:
    """Return models of (x, vx, ax) [m, m/s, m/s^2], measured in x, or in x and vx.

    Constant velocity ignores and clears the acceleration; constant acceleration keeps it; standing clears
    the velocity, too.

    Args:
        kinds: ``"cv"`` or ``"ca"`` for each mode.
        dt: Step [s].
        noise: Variance of the random acceleration of a step [(m/s^2)^2].
        variances: Measurement variances of x [m^2] and, if it is measured, of vx [(m/s)^2].
        stay: Probability of keeping the mode for one step.
    """
    dynamics = {
        "cv": [[1.0, dt, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 0.0]],
        "ca": [[1.0, dt, dt**2 / 2], [0.0, 1.0, dt], [0.0, 0.0, 1.0]],
        "stand": [[1.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]],
    }
    gain = np.array([dt**2 / 2, dt, 1.0])
    m, moving = len(kinds), noise * np.outer(gain, gain)
    standing = np.diag([_STANDING_NOISE * variances[0], 0.0, 0.0])
    return ModelSet(
        dynamics=np.array([dynamics[kind] for kind in kinds]),
        offset=np.zeros((m, 3)),
        noise=np.array([standing if kind == "stand" else moving for kind in kinds]),
        measurement_variance=np.array(variances, dtype=float),
        transition=transition_matrix(m, stay, kinds.index("stand") if "stand" in kinds else None),
    )


def lateral_models(
    derivative_gains: Sequence[float],
    proportional_gain: float,
    lanes: Sequence[float],
    dt: float,
    noise: float,
    variance: float,
    stay: float,
    speed_variance: float | None = None,
    stands: bool = False,
) -> ModelSet:
    """Return models of (y, vy) [m, m/s], measured in y, or in both: drivers who steer towards a lane centre.

    Mode g * L + l has derivative gain g and lane l of L; its acceleration is kp (lane - y) - kd vy. The last
    mode may be that of a vehicle that stands, which does not move sideways either.

    Args:
        derivative_gains: kd [1/s].
        proportional_gain: kp [1/s^2].
        lanes: Lane centres [m].
        dt: Step [s].
        noise: Variance of the random acceleration of a step [(m/s^2)^2].
        variance: Measurement variance of y [m^2].
        stay: Probability of keeping the mode for one step.
        speed_variance: Measurement variance of vy [(m/s)^2]; None: it is not measured.
        stands: Whether there is a mode that stands.
    """
    kp = proportional_gain
    modes = [(kd, lane) for kd in derivative_gains for lane in lanes]
    dynamics = [[[1.0, dt], [-dt * kp, 1.0 - dt * kd]] for kd, _ in modes]
    offset = [[0.0, dt * kp * lane] for _, lane in modes]
    gain = np.array([dt**2 / 2, dt])
    noises = [noise * np.outer(gain, gain)] * len(modes)
    if stands:
        dynamics.append([[1.0, 0.0], [0.0, 0.0]])
        offset.append([0.0, 0.0])
        noises.append(np.diag([_STANDING_NOISE * variance, 0.0]))
    m = len(offset)
    return ModelSet(
        dynamics=np.array(dynamics),
        offset=np.array(offset),
        noise=np.array(noises),
        measurement_variance=np.array([variance] if speed_variance is None else [variance, speed_variance]),
        transition=transition_matrix(m, stay, m - 1 if stands else None),
    )


def transition_matrix(modes: int, stay: float, standing: int | None = None) -> Floats:
    """Return the (M, M) chain that stays with probability ``stay``, else jumps to another mode uniformly.

    Args:
        modes: M.
        stay: Probability of keeping the mode for one step.
        standing: Mode of a vehicle that stands, which begins and ends with ``STOP`` and ``GO``.
    """
    moving = modes if standing is None else modes - 1
    matrix = np.full((moving, moving), (1.0 - stay) / max(moving - 1, 1))
    np.fill_diagonal(matrix, stay if moving > 1 else 1.0)
    if standing is None:
        return matrix
    matrix = np.insert((1.0 - STOP) * matrix, standing, STOP, axis=1)
    row = np.full(modes, GO / max(moving, 1))
    row[standing] = 1.0 - GO if moving else 1.0
    return np.insert(matrix, standing, row, axis=0)


def look_ahead(models: ModelSet, steps: int) -> Horizon:
    """Return the first state component after 0..``steps`` steps without noise."""
    m, n = models.offset.shape
    power = np.broadcast_to(np.eye(n), (m, n, n))
    drift = np.zeros((m, n))
    weights, offsets = [power[:, 0]], [drift[:, 0]]
    for _ in range(steps):
        drift = np.einsum("mij,mj->mi", models.dynamics, drift) + models.offset
        power = np.einsum("mij,mjk->mik", models.dynamics, power)
        weights.append(power[:, 0])
        offsets.append(drift[:, 0])
    return Horizon(np.array(weights), np.array(offsets))
