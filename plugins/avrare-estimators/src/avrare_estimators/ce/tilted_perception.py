"""Network family of cross-entropy: the target's perception, tilted by a network (stl-ams, "Imp-CE").

Target and proposal are one observation model with different numbers: a network of zeros is the target
itself, and heavy tails stay heavy. The tilt is five numbers: log odds of a detection, centre and log scale of
the errors along and across the vehicle. The network runs in NumPy; ``training`` fits it in torch.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from avrare.driving import Observation, Scene, World
from avrare.protocols import Floats

INPUTS, OUTPUTS = 8, 5


def network_inputs(world: World, scene: Scene) -> Floats:
    """Return the visible state (N, V, 8) of each other vehicle.

    Distance ahead, to the left, and in all [m]; cosine and sine of its heading relative to the ego's; its
    speed along the ego's heading minus the ego's [m/s]; its length and width [m].
    """
    ego, others = world.ego, world.others
    heading = ego.heading[:, None]
    dx, dy = others.x - ego.x[:, None], others.y - ego.y[:, None]
    forward = np.cos(heading) * dx + np.sin(heading) * dy
    left = np.cos(heading) * dy - np.sin(heading) * dx
    turned = others.heading - heading
    columns = (
        forward,
        left,
        np.sqrt(forward * forward + left * left),
        np.cos(turned),
        np.sin(turned),
        others.speed * np.cos(turned) - ego.speed[:, None],
        scene.lengths,
        scene.widths,
    )
    return np.stack(np.broadcast_arrays(*columns), axis=-1)


@dataclass(frozen=True)
class TiltNetwork:
    """Network with two hidden layers of rectified linear units.

    Attributes:
        centre: (8,) subtracted from the inputs.
        spread: (8,) divides them.
        layers: Weights (from, to) and biases (to,) of the three layers, in turn.
    """

    centre: Floats
    spread: Floats
    layers: tuple[Floats, ...]

    def __call__(self, inputs: Floats) -> Floats:
        """Return tilts (N, V, 5) of inputs (N, V, 8); no row depends on another (einsum, not BLAS)."""
        values = (inputs - self.centre) / self.spread
        for weights, bias in zip(self.layers[0:4:2], self.layers[1:4:2], strict=True):
            values = np.maximum(np.einsum("nvi,ij->nvj", values, weights) + bias, 0.0)
        return np.asarray(np.einsum("nvi,ij->nvj", values, self.layers[4]) + self.layers[5])


@dataclass(frozen=True)
class TrainingBatch:
    """Observations to learn from, M of single vehicles.

    Attributes:
        inputs: (M, 8).
        detected: (M,) the vehicle was detected.
        log_odds: (M,) log odds of a detection under the target.
        residuals: (M, 2) errors in units of the target's law.
        weights: (M,) weight of the rollout of each.
        dof: Degrees of freedom of the residuals' law along and across; None: normal.
    """

    inputs: Floats
    detected: Floats
    log_odds: Floats
    residuals: Floats
    weights: Floats
    dof: tuple[float, float] | None


@dataclass(frozen=True)
class Tilt:
    """Proposal of a request: tilts whatever perception the closed loop has."""

    network: TiltNetwork

    def for_target(self, target: object) -> TiltedPerception:
        """Return the target perception model, tilted."""
        return TiltedPerception(self.network, target)


@dataclass(frozen=True)
class TiltedPerception:
    """A perception error model whose law is the target's with other numbers."""

    network: TiltNetwork
    target: Any

    @property
    def noise_size(self) -> int:
        """Noise size of the target."""
        return int(self.target.noise_size)

    def law(self, world: World) -> Any:
        """Return the target's law of the observation of ``world``, tilted."""
        law, tilt = self.target.law(world), self.network(network_inputs(world, self.target.scene))
        tilted_detect = law.detect * np.exp(tilt[..., 0])
        total = tilted_detect + law.miss
        return replace(
            law,
            detect=tilted_detect / total,
            miss=law.miss / total,
            location=law.location + law.scale * tilt[..., 1:3],
            scale=law.scale * np.exp(tilt[..., 3:5]),
        )

    def observe(self, world: World, noise: Floats) -> Observation:
        """Draw one observation of every other vehicle."""
        return self.law(world).draw(world, noise)  # type: ignore[no-any-return]

    def log_prob(self, world: World, observation: Observation) -> Floats:
        """Return the log density (N,) of an observation."""
        return self.law(world).log_prob(world, observation)  # type: ignore[no-any-return]


def residuals(law: Any, world: World, observation: Observation) -> Floats:
    """Return the errors (N, V, 2) along and across each vehicle over the law's scale; 0 where missed."""
    others = world.others
    dx = np.where(observation.detected, others.x - observation.x, 0.0)
    dy = np.where(observation.detected, others.y - observation.y, 0.0)
    cos, sin = np.cos(others.heading), np.sin(others.heading)
    errors = np.stack([cos * dx + sin * dy, cos * dy - sin * dx], axis=-1)
    seen = observation.detected[..., None]
    return np.asarray(np.where(seen, (errors - law.location) / law.scale, 0.0))
