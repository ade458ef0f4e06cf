"""The learnt proposal of stl-ams ("Imp-CE"): a network from what there is to see to how it is perceived.

The network tilts the target's own law of each observation: log odds of a detection, centre and log scale of
the errors along and across the vehicle. Target and proposal are therefore one observation model with
different numbers, a network of zeros is the target itself, and heavy tails stay heavy. This is the form that
runs, in NumPy; ``training`` has the torch side.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from avrare.build.weighted import WeightedProblem
from avrare.driving import Observation
from avrare.errors import PluginError
from avrare.protocols import Floats
from avrare.rollout.problem import Problem
from avrare.rollout.request import Integers
from avrare_estimators.config import CeConfig
from avrare_estimators.gaussian import level_nats
from avrare_estimators.sampling import Sample
from avrare_estimators.sources import PerceptionSource, Source

INPUTS, OUTPUTS = 8, 5


def inputs(world: Any, scene: Any) -> Floats:
    """(N, V, 8) what there is to see of each other vehicle.

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
        forward, left, np.sqrt(forward * forward + left * left), np.cos(turned), np.sin(turned),
        others.speed * np.cos(turned) - ego.speed[:, None], scene.lengths, scene.widths,
    )  # fmt: skip
    return np.stack(np.broadcast_arrays(*columns), axis=-1)


def residuals(law: Any, world: Any, observation: Observation) -> Floats:
    """(N, V, 2) errors along and across each vehicle in units of the law's scale; 0 where it was missed."""
    others = world.others
    dx = np.where(observation.detected, others.x - observation.x, 0.0)
    dy = np.where(observation.detected, others.y - observation.y, 0.0)
    cos, sin = np.cos(others.heading), np.sin(others.heading)
    errors = np.stack([cos * dx + sin * dy, cos * dy - sin * dx], axis=-1)
    seen = observation.detected[..., None]
    return np.asarray(np.where(seen, (errors - law.location) / law.scale, 0.0))


@dataclass(frozen=True)
class Network:
    """Two hidden layers of rectified units.

    Attributes:
        centre: (8,) subtracted from the inputs.
        spread: (8,) divides them.
        layers: Weights (from, to) and biases (to,) of the three layers, in turn.
    """

    centre: Floats
    spread: Floats
    layers: tuple[Floats, ...]

    def __call__(self, seen: Floats) -> Floats:
        """(N, V, 5) from (N, V, 8); no row depends on another (einsum, not BLAS)."""
        values = (seen - self.centre) / self.spread
        for weights, bias in zip(self.layers[0:4:2], self.layers[1:4:2], strict=True):
            values = np.maximum(np.einsum("nvi,ij->nvj", values, weights) + bias, 0.0)
        return np.asarray(np.einsum("nvi,ij->nvj", values, self.layers[4]) + self.layers[5])

    def of(self, target: Any) -> TiltedPem:
        """The target perception model, tilted."""
        return TiltedPem(self, target)


@dataclass(frozen=True)
class TiltedPem:
    """A perception error model whose law is the target's with other numbers."""

    network: Network
    target: Any

    @property
    def noise_size(self) -> int:
        """As the target's."""
        return int(self.target.noise_size)

    def law(self, world: Any) -> Any:
        """The target's law of the observation of ``world``, tilted."""
        law, tilt = self.target.law(world), self.network(inputs(world, self.target.scene))
        odds = law.detect * np.exp(tilt[..., 0])
        whole = odds + law.miss
        return replace(
            law, detect=odds / whole, miss=law.miss / whole,
            location=law.location + law.scale * tilt[..., 1:3], scale=law.scale * np.exp(tilt[..., 3:5]),
        )  # fmt: skip

    def observe(self, world: Any, noise: Floats) -> Observation:
        """One observation of every other vehicle."""
        return self.law(world).draw(world, noise)  # type: ignore[no-any-return]

    def log_prob(self, world: Any, observation: Observation) -> Floats:
        """(N,) log density."""
        return self.law(world).log_prob(world, observation)  # type: ignore[no-any-return]


@dataclass(frozen=True)
class Lessons:
    """Observations to learn from, M of single vehicles.

    Attributes:
        inputs: (M, 8).
        detected: (M,).
        log_odds: (M,) of a detection, under the target.
        residuals: (M, 2) in units of the target's law.
        weights: (M,) of the rollout that each is from.
        dof: Degrees of freedom of the residuals' law along and across; None: normal.
    """

    inputs: Floats
    detected: Floats
    log_odds: Floats
    residuals: Floats
    weights: Floats
    dof: tuple[float, float] | None


def lessons(sample: Sample, rows: Integers, weights: Floats, target: Any) -> Lessons:
    """What the states along ``rows`` of a sample show; the rows' weights add up to 1."""
    weight = np.zeros(len(sample.error))
    weight[rows] = weights
    parts: list[tuple[Floats, ...]] = []
    dof = None
    for _, present, carry in sample.carries:
        state, mine = carry.system.loop, weight[present]
        if state.observation is None or not mine.any():
            continue
        law = target.law(state.world)
        dof = getattr(law, "dof", None)
        with np.errstate(divide="ignore"):
            log_odds = np.clip(np.log(law.detect) - np.log(law.miss), -50.0, 50.0)
        seen = inputs(state.world, target.scene)
        each = np.broadcast_to(mine[:, None], seen.shape[:2])
        chosen = each > 0.0
        columns = (seen, state.observation.detected, log_odds, residuals(law, state.world, state.observation))
        parts.append(tuple(np.asarray(c[chosen], dtype=np.float64) for c in (*columns, each)))
    seen, detected, log_odds, errors, each = (np.concatenate(column) for column in zip(*parts, strict=True))
    return Lessons(seen, detected, log_odds, errors, each, dof)


class NetworkFamily:
    """Tilts of the target's perception; needs torch to learn, not to run.

    Raises:
        PluginError: torch is not installed.
    """

    def __init__(self, config: CeConfig) -> None:
        from importlib.util import find_spec

        if find_spec("torch") is None:
            raise PluginError(
                "the network family of estimator 'ce' needs torch", "pip install 'avrare-estimators[torch]'"
            )
        self.config = config
        self.target: Any = None

    def prepare(self, problem: Problem) -> Problem:
        """The closed loop that can be drawn from tilted perception."""
        prepared = WeightedProblem(problem, needs="law")
        self.target = prepared.system.target.perception  # type: ignore[attr-defined]
        return prepared

    def start(self) -> Source:
        """The target itself."""
        return PerceptionSource()

    def watched(self, source: Source) -> Source:
        """The same, with the states of every step to learn from."""
        assert isinstance(source, PerceptionSource)
        return replace(source, keep_carries=True)

    def fit(self, sample: Sample, rows: Integers, weights: Floats) -> Source:
        """The network that makes the rows' observations likeliest, starting from the one they came from."""
        from avrare_estimators.training import train

        source, part = sample.source, sample.parts[0]
        assert isinstance(source, PerceptionSource)
        seed = np.random.SeedSequence(part.plan.noise.seed, spawn_key=(part.run, part.stage))
        found = lessons(sample, rows, weights, self.target)
        nats = level_nats(sample, self.config.elite)
        start = int(seed.generate_state(1)[0])
        return PerceptionSource(train(found, source.proposal, self.config, start, nats))
