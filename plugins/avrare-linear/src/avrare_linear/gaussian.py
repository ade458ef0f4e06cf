"""Distribution of a linear system's trajectories: an affine map of the noise tape (stl-ess, Eq. 11-12).

The map is computed by running the system once without noise, and once for each number of the tape. It exists
for every system that is affine in its noise, not only for ``LinearSystem``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from avrare.base.errors import UsageError, did_you_mean
from avrare.protocols import Floats, System
from avrare.rollout.noise import NoiseSource

_CHECKS, _TOLERANCE, _ROUNDING = 8, 1e-9, 1e-12


@dataclass(frozen=True, eq=False)
class TrajectoryGaussian:
    """Signals = mean + map times tape, with a standard normal tape of D = (T + 1) x noise_size numbers.

    Attributes:
        names: Names of the n signals.
        mean: (T + 1, n) mean.
        map: (T + 1, n, D) linear map of the tape's numbers, in the order of its rows.
    """

    names: tuple[str, ...]
    mean: Floats
    map: Floats

    @staticmethod
    def of(system: System, steps: int, names: Sequence[str] | None = None) -> TrajectoryGaussian:
        """Compute the distribution of a system's signals at t = 0..steps.

        Args:
            system: System with signals that are affine in the noise, which is checked at a few tapes.
            steps: T.
            names: Names of the signals; None: all.

        Raises:
            UsageError: A signal does not exist, has a vehicle axis, overflows, or is not affine in the noise.
        """
        with np.errstate(over="ignore", invalid="ignore"):  # the check names the signal
            gaussian = TrajectoryGaussian.from_affine(system, steps, names)
            gaussian._check(system)
        return gaussian

    @staticmethod
    def from_affine(system: System, steps: int, names: Sequence[str] | None = None) -> TrajectoryGaussian:
        """Compute the distribution of a system that is known to be affine; complex if its matrices are."""
        shape = (steps + 1, system.noise_size)
        size = shape[0] * shape[1]
        mean = simulate_signals(system, np.zeros((1, *shape)), names)
        signals = tuple(mean)
        middle = np.stack([mean[name][0] for name in signals], axis=1)
        parts = [np.empty((0, *middle.shape))]
        batch = 1024
        for first in range(0, size, batch):
            units = np.eye(min(batch, size - first), size, first).reshape(-1, *shape)
            columns = simulate_signals(system, units, signals)
            parts.append(np.stack([columns[name] for name in signals], axis=2) - middle)
        return TrajectoryGaussian(signals, middle, np.concatenate(parts).transpose(1, 2, 0))

    @property
    def steps(self) -> int:
        """Number of steps T."""
        return len(self.mean) - 1

    @property
    def covariance(self) -> Floats:
        """Covariance (T + 1, n, T + 1, n) of all signals at all samples."""
        flat = self.map.reshape(-1, self.map.shape[2])
        return np.asarray(flat @ flat.T).reshape(self.mean.shape * 2)

    def select(self, names: Sequence[str]) -> TrajectoryGaussian:
        """Return the distribution of some of the signals.

        Raises:
            UsageError: A signal does not exist.
        """
        for name in names:
            if name not in self.names:
                raise UsageError(f"unknown signal {name!r}", did_you_mean(name, self.names))
        places = [self.names.index(name) for name in names]
        return TrajectoryGaussian(tuple(names), self.mean[:, places], self.map[:, places])

    def signals(self, tape: Floats) -> dict[str, Floats]:
        """Return the signals (N, T + 1) by name, of tapes (N, T + 1, noise_size)."""
        values = self.mean + self.deviations(tape)
        return {name: np.ascontiguousarray(values[:, :, i]) for i, name in enumerate(self.names)}

    def deviations(self, tape: Floats) -> Floats:
        """Return the signals (N, T + 1, n) of tapes (N, T + 1, noise_size), less their mean."""
        flat = self.map.reshape(-1, self.map.shape[2])
        return apply_map(flat, tape).reshape(len(tape), *self.mean.shape)

    def _check(self, system: System) -> None:
        # The tolerance is relative to the spread, not to the mean.
        steps = np.arange(len(self.mean))
        tape = 3.0 * NoiseSource(0, system.noise_size).normals(0, 0, np.arange(_CHECKS)[:, None], steps)
        expected, simulated = self.signals(tape), simulate_signals(system, tape, self.names)
        for k, name in enumerate(self.names):
            if not (np.isfinite(simulated[name]).all() and np.isfinite(expected[name]).all()):
                raise UsageError(
                    f"signal {name!r} is not finite: its trajectories have no Gaussian distribution",
                    "unstable systems overflow: check the matrices and the number of steps",
                )
            spread = np.abs(simulated[name] - self.mean[:, k]).max(initial=1.0)
            allowed = _TOLERANCE * spread + _ROUNDING * np.abs(simulated[name]).max()
            if not np.allclose(expected[name], simulated[name], rtol=0.0, atol=allowed):
                raise UsageError(
                    f"signal {name!r} is not affine in the noise: its trajectories are not Gaussian",
                    "exact slices and gradients need a linear system, such as the simulator `linear`",
                )


def simulate_signals(system: System, tape: Floats, names: Sequence[str] | None = None) -> dict[str, Floats]:
    """Run a system under tapes (N, T + 1, noise_size) and return its signals (N, T + 1).

    Raises:
        UsageError: A signal does not exist or has a vehicle axis.
    """
    state = system.initial(tape[:, 0])
    samples = [system.signals(state)]
    for t in range(1, tape.shape[1]):
        state = system.step(state, tape[:, t])
        samples.append(system.signals(state))
    for name in names if names is not None else samples[0]:
        if name not in samples[0]:
            raise UsageError(f"the system has no signal {name!r}", did_you_mean(name, samples[0]))
        if samples[0][name].ndim != 1:
            raise UsageError(f"signal {name!r} has more than one value a particle", "exact slices need (N,)")
    chosen = tuple(names) if names is not None else tuple(samples[0])
    return {name: np.stack([sample[name] for sample in samples], axis=1) for name in chosen}


def apply_map(matrix: Floats, tape: Floats) -> Floats:
    """Multiply a matrix (K, D) by each tape (N, ...) of D numbers: (N, K).

    The sum runs number by number, so that no row depends on its neighbours, which BLAS does not guarantee.
    """
    flat = tape.reshape(len(tape), -1)
    out = np.zeros((len(flat), len(matrix)))
    used = matrix != 0.0
    for d in np.flatnonzero(used.any(axis=0)):
        rows = np.flatnonzero(used[:, d])
        part = slice(rows[0], rows[-1] + 1)  # earlier samples do not depend on this number
        out[:, part] += flat[:, d, None] * matrix[part, d]
    return out
