"""Training of the tilt network in torch: weighted maximum likelihood on the observations of an elite."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import torch

from avrare_estimators.ce.config import CeConfig
from avrare_estimators.ce.tilted_perception import INPUTS, OUTPUTS, TiltNetwork, TrainingBatch


def train(
    batch: TrainingBatch, start: TiltNetwork | None, options: CeConfig, seed: int, nats: float
) -> TiltNetwork:
    """Return the network after ``options.epochs`` steps of Adam; the same bits for the same seed.

    A law under which an event of probability p is likely need differ from the target by no more than -log p
    nats. Any further divergence is noise of a small elite, and is scaled back.

    Args:
        batch: Observations to make likely.
        start: First network; None: random hidden layers, and the target itself as output.
        options: Options of the estimator.
        seed: Seed of the hidden layers.
        nats: Largest divergence of a rollout's law from the target's.
    """
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        trained = _descend(batch, start or _start_network(batch, options.hidden, seed), options)
        return _limit_divergence(trained, batch, nats)
    finally:
        torch.set_num_threads(threads)


def _start_network(batch: TrainingBatch, hidden: int, seed: int) -> TiltNetwork:
    rng = np.random.default_rng(seed)
    sizes = ((INPUTS, hidden), (hidden, hidden))
    layers = [part for a, b in sizes for part in (rng.normal(0, math.sqrt(2 / a), (a, b)), np.zeros(b))]
    output = (np.zeros((hidden, OUTPUTS)), np.zeros(OUTPUTS))
    spread = batch.inputs.std(axis=0)
    return TiltNetwork(batch.inputs.mean(axis=0), np.where(spread > 1e-6, spread, 1.0), (*layers, *output))


def _descend(batch: TrainingBatch, start: TiltNetwork, options: CeConfig) -> TiltNetwork:
    layers = [torch.tensor(layer, requires_grad=True) for layer in start.layers]
    inputs = torch.tensor((batch.inputs - start.centre) / start.spread)
    optimiser = torch.optim.Adam(layers, lr=options.rate)
    for _ in range(options.epochs):
        optimiser.zero_grad()
        loss = _loss(_forward(layers, inputs), batch)
        loss.backward()
        optimiser.step()
    return TiltNetwork(start.centre, start.spread, tuple(layer.detach().numpy().copy() for layer in layers))


def _forward(layers: Sequence[torch.Tensor], values: torch.Tensor) -> torch.Tensor:
    for weights, bias in zip(layers[0:4:2], layers[1:4:2], strict=True):
        values = torch.relu(values @ weights + bias)
    return values @ layers[4] + layers[5]


def _loss(tilt: torch.Tensor, batch: TrainingBatch) -> torch.Tensor:
    detected = torch.tensor(batch.detected)
    log_odds = torch.tensor(batch.log_odds) + tilt[:, 0]
    nll = torch.nn.functional.binary_cross_entropy_with_logits(log_odds, detected, reduction="none")
    for axis in (0, 1):
        scale = tilt[:, 3 + axis]
        standard = (torch.tensor(batch.residuals[:, axis]) - tilt[:, 1 + axis]) * torch.exp(-scale)
        dof = batch.dof[axis] if batch.dof is not None else math.inf
        size = 0.5 * standard**2 if math.isinf(dof) else (dof + 1) / 2 * torch.log1p(standard**2 / dof)
        nll = nll + detected * (size + scale)
    weights = torch.tensor(batch.weights)
    weights = weights / weights.sum()
    # the penalty keeps the target's law where it does not matter for failure
    return (weights * (nll + 0.05 * (tilt**2).sum(dim=1))).sum()


def _limit_divergence(network: TiltNetwork, batch: TrainingBatch, nats: float) -> TiltNetwork:
    """Scale the tilts until rollouts diverge from the target by ``nats`` at most.

    To second order in the tilts, a rollout's divergence is a weighted sum of their squares: Fisher's
    information of a coin's log odds, of a location, and of a log scale.
    """
    tilt = network(batch.inputs[:, None])[:, 0]
    seen = 1.0 / (1.0 + np.exp(-batch.log_odds))
    errors = 0.5 * (tilt[:, 1:3] ** 2).sum(axis=1) + (tilt[:, 3:5] ** 2).sum(axis=1)
    divergence = (batch.weights * seen * (0.5 * (1.0 - seen) * tilt[:, 0] ** 2 + errors)).sum()
    scale = math.sqrt(min(1.0, nats / max(float(divergence), 1e-300)))
    *hidden, weights, bias = network.layers
    return TiltNetwork(network.centre, network.spread, (*hidden, scale * weights, scale * bias))
