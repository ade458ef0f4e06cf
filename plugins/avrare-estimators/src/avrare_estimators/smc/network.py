"""Small network in NumPy: from features at a step to the probability of reaching each of several levels.

It is trained in the main process by Adam on weighted rollouts, balanced so that each level's successes weigh
as much as all else (logistic regression with a known offset). Training is deterministic; its weights are
then rounded and frozen. Evaluation adds row by row, without a matrix library: no row's bits depend on the
others.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from avrare.protocols import Bools, Floats
from avrare.rollout.request import Integers

_BATCH, _RATE, _DECAY = 256, 4e-3, 1e-4
_LEAST_STEPS, _MOST_STEPS, _EPOCHS = 300, 1500, 20
_LIMIT = 6.0
"""Largest standardised feature."""
_BLOCK = 2**12
"""Rows that are evaluated at once."""
Layers = tuple[Floats, ...]


@dataclass(frozen=True)
class Examples:
    """Rollouts to learn from, at K steps.

    Attributes:
        features: (n, K, F); NaN where a rollout had ended.
        reached: (n, L) the rollout reaches the level.
        weights: (n,) their mean over a set estimates its probability.
        held_out: (n,) not to train on.
    """

    features: Floats
    reached: Bools
    weights: Floats
    held_out: Bools


@dataclass(frozen=True)
class Network:
    """A network for K steps and L levels.

    Attributes:
        centre: (K, F) means of the features at each step.
        spread: (K, F) their standard deviations.
        layers: Weights and biases of three layers.
        offset: (L,) log odds of each level before anything is known.
    """

    centre: Floats
    spread: Floats
    layers: Layers
    offset: Floats

    def probabilities(self, step: int, features: Floats) -> Floats:
        """Return the probabilities (n, L) of reaching each level from features (n, F) at the step number."""
        blocks = range(0, max(1, len(features)), _BLOCK)
        return np.concatenate([self._evaluate(step, features[begin : begin + _BLOCK]) for begin in blocks])

    def _evaluate(self, step: int, features: Floats) -> Floats:
        first, b1, second, b2, third, b3 = self.layers
        values = self.inputs(np.full(len(features), step), features)
        values = np.tanh(np.einsum("ni,io->no", values, first) + b1)
        values = np.tanh(np.einsum("ni,io->no", values, second) + b2)
        return sigmoid(np.einsum("ni,io->no", values, third) + b3 + self.offset)

    def inputs(self, steps: Integers, features: Floats) -> Floats:
        """Return the inputs (n, I) of the first layer from features (n, F) at scheduled steps (n,)."""
        standard = (features - self.centre[steps]) / self.spread[steps]
        standard = np.clip(np.nan_to_num(standard, nan=0.0, posinf=_LIMIT, neginf=-_LIMIT), -_LIMIT, _LIMIT)
        return np.concatenate([standard, _times(len(self.centre))[steps]], axis=1)


def sigmoid(values: Floats) -> Floats:
    """Return 1 / (1 + exp(-x)) without overflow."""
    return np.asarray(0.5 + 0.5 * np.tanh(0.5 * values))


def fit(examples: Examples, seed: tuple[int, ...]) -> Network:
    """Return the network with the least loss on the rows held out; the same bits for the same ``seed``."""
    rng = np.random.default_rng(seed)
    chance = _chance(examples)
    network = _start_network(examples, np.log(chance / (1.0 - chance)), rng)
    held, trained = np.flatnonzero(examples.held_out), np.flatnonzero(~examples.held_out)
    sampler = _Sampler(network, examples, chance, trained)
    test = _Sampler(network, examples, chance, held).draw(4 * _BATCH, rng)
    layers, moments = list(network.layers), [np.zeros_like(layer) for _ in (0, 1) for layer in network.layers]
    best, least = network, _loss(network, test)
    epoch = len(trained) * examples.features.shape[1] / _BATCH
    steps = int(np.clip(_EPOCHS * epoch, _LEAST_STEPS, _MOST_STEPS))
    for turn in range(1, steps + 1):
        batch = sampler.draw(_BATCH, rng)
        rate = _RATE * 0.5 * (1.0 + np.cos(np.pi * turn / steps))
        _adam(layers, _gradients(layers, batch), moments, rate, turn)
        if turn % 100 == 0:  # a look at the rows held out
            now = replace(network, layers=tuple(layer.copy() for layer in layers))
            if (loss := _loss(now, test)) < least:
                best, least = now, loss
    return replace(best, layers=tuple(np.round(layer, 5) for layer in best.layers))


def _chance(examples: Examples) -> Floats:
    weights = examples.weights[:, None] / examples.weights.sum()
    return np.asarray(np.clip((weights * examples.reached).sum(axis=0), 1e-12, 1.0 - 1e-6))


def _start_network(examples: Examples, offset: Floats, rng: np.random.Generator) -> Network:
    # Step by step: the features of all steps are the largest table there is.
    steps, size = examples.features.shape[1:]
    moments = [_moments(examples.features[:, k]) for k in range(steps)]
    centre, spread = (np.array(part) for part in zip(*moments, strict=True))
    # What hardly varies at a step must not be blown up there.
    spread = np.maximum(spread, 0.05 * spread.max(axis=0) + 1e-9)
    inputs = size + _times(steps).shape[1]
    width = 32
    sizes = ((inputs, width), (width, width), (width, len(offset)))
    layers = [part for a, b in sizes for part in (rng.normal(0.0, a**-0.5, (a, b)), np.zeros(b))]
    layers[4] *= 0.1
    rounded = (np.round(part, 9) for part in (centre, spread, offset))
    centre, spread, offset = rounded
    return Network(centre, np.maximum(spread, 1e-9), tuple(layers), offset)


def _moments(features: Floats) -> tuple[Floats, Floats]:
    """Return the means (F,) and standard deviations (F,) of the finite values of features (n, F)."""
    seen = np.isfinite(features)
    count = np.maximum(seen.sum(axis=0), 1)
    centre = np.where(seen, features, 0.0).sum(axis=0) / count
    return centre, np.sqrt((np.where(seen, features - centre, 0.0) ** 2).sum(axis=0) / count)


def _times(count: int) -> Floats:
    # What the network knows of the time at each of ``count`` steps.
    u = (np.arange(count) / max(count - 1, 1))[:, None]
    waves = np.pi * u * np.arange(1, 4)
    return np.concatenate([2.0 * u - 1.0, np.sin(waves), np.cos(waves)], axis=1)


@dataclass(frozen=True)
class _Batch:
    inputs: Floats  # (B, I)
    success: Floats  # (B, L) weights of the levels that are reached
    defeat: Floats  # (B, L) weights of the others


class _Sampler:
    """Rows drawn so that each level's successes are as frequent as all rows, at a step of each at random."""

    def __init__(self, network: Network, examples: Examples, chance: Floats, rows: Integers) -> None:
        self.network, self.examples, self.chance, self.rows = network, examples, chance, rows
        self.excess = 1.0 + examples.reached[rows] @ (1.0 / chance)
        self.ends = np.cumsum(examples.weights[rows] * self.excess)
        # The score is there for as long as the rollout goes on.
        self.length = (~np.isnan(examples.features[rows, :, -1])).sum(axis=1)

    def draw(self, size: int, rng: np.random.Generator) -> _Batch:
        """Return ``size`` rows with the weights that make up for how they were drawn."""
        places = np.searchsorted(self.ends, self.ends[-1] * rng.random(size), side="right")
        picked = np.minimum(places, len(self.rows) - 1)
        drawn, last = self.rows[picked], np.maximum(self.length[picked], 1)
        steps = np.minimum((rng.random(size) * last).astype(np.int64), last - 1)
        inputs = self.network.inputs(steps, self.examples.features[drawn, steps].astype(np.float64))
        reached, chance = self.examples.reached[drawn], self.chance
        weight = ((self.length[picked] > 0) / self.excess[picked])[:, None]
        return _Batch(inputs, weight * reached / chance, weight * ~reached / (1.0 - chance))


def _forward(layers: list[Floats], inputs: Floats) -> tuple[Floats, Floats, Floats]:
    first = np.tanh(inputs @ layers[0] + layers[1])
    second = np.tanh(first @ layers[2] + layers[3])
    return first, second, second @ layers[4] + layers[5]


def _loss(network: Network, batch: _Batch) -> float:
    logits = _forward(list(network.layers), batch.inputs)[2]
    losses = batch.success * np.logaddexp(0.0, -logits) + batch.defeat * np.logaddexp(0.0, logits)
    return float(losses.mean())


def _gradients(layers: list[Floats], batch: _Batch) -> list[Floats]:
    first, second, logits = _forward(layers, batch.inputs)
    chance = sigmoid(logits)
    out = (batch.defeat * chance - batch.success * (1.0 - chance)) / len(logits)
    back = (out @ layers[4].T) * (1.0 - second**2)
    deep = (back @ layers[2].T) * (1.0 - first**2)
    return [
        batch.inputs.T @ deep,
        deep.sum(axis=0),
        first.T @ back,
        back.sum(axis=0),
        second.T @ out,
        out.sum(axis=0),
    ]


def _adam(
    layers: list[Floats], gradients: list[Floats], moments: list[Floats], rate: float, turn: int
) -> None:
    for k, gradient in enumerate(gradients):
        mean, square = moments[k], moments[k + len(layers)]
        mean += 0.1 * (gradient - mean)
        square += 0.001 * (gradient * gradient - square)
        step = (mean / (1.0 - 0.9**turn)) / (np.sqrt(square / (1.0 - 0.999**turn)) + 1e-8)
        layers[k] = layers[k] - rate * (step + _DECAY * layers[k])
