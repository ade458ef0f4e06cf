"""Training of small networks with torch: detection and Student-t errors from one trunk.

The training rows are cut into as many blocks as there are networks. Each network is trained on all blocks
but its own, and its parameters are those that predict its own block best. So every row has a prediction by a
network that has not seen its scene, as calibration needs. The model is the mean of the networks.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from avrare.protocols import Bools, Floats
from avrare_gp_pem.runtime.networks import Networks, networks
from avrare_pem_training.calibration import MIN_DOF

OUTPUTS = 5


@dataclass(frozen=True)
class Recipe:
    """Shape and training of the networks.

    Attributes:
        hidden: Widths of the hidden layers; empty: a generalised linear model.
        varying: True if location and scale of the errors depend on the inputs beyond a scale linear in range.
        members: Number of networks.
        epochs: Passes over the rows of the first, shortest schedule.
        least_steps: Minimum number of its steps, where rows are few.
        least_gain: The schedule is doubled, from new weights, until blocks left out gain less [nats per row].
        batch: Rows per step.
        rate: Initial learning rate of AdamW, falling to zero along a cosine.
        decay: Weight decay of AdamW.
        dropout: Share of hidden units dropped in each step.
    """

    hidden: tuple[int, ...] = (32, 32)
    varying: bool = True
    members: int = 5
    epochs: int = 25
    least_steps: int = 600
    least_gain: float = 0.005
    batch: int = 512
    rate: float = 3e-3
    decay: float = 1e-2
    dropout: float = 0.1

    def settle_schedule(self, doubled: int) -> Recipe:
        """Return the recipe whose only schedule is the shortest one, so many times as long."""
        longer = doubled * self.epochs, doubled * self.least_steps
        return replace(self, epochs=longer[0], least_steps=longer[1], least_gain=math.inf)


@dataclass(frozen=True)
class Sample:
    """Training rows.

    Attributes:
        x: (n, D) normalised inputs.
        detected: (n,) outcomes.
        standard: (n, 2) errors divided by their base scale; any finite number where missed.
    """

    x: Floats
    detected: Bools
    standard: Floats


def fit_networks(
    sample: Sample, recipe: Recipe, seed: int, report: Callable[[str], None]
) -> tuple[Networks, Floats, Recipe]:
    """Train an ensemble.

    Args:
        sample: Rows in the order of recording.
        recipe: Shape and training.
        seed: Seed of initial weights, batches and dropout; it determines every bit on the same machine.
        report: Called with a line when done.

    Returns:
        The networks, (n, 5) outputs for each row by the network that has not seen its block, and the recipe
        with the schedule that was found.
    """
    blocks = np.array_split(np.arange(len(sample.x)), recipe.members)
    threads = torch.get_num_threads()
    with torch.random.fork_rng(devices=[]):
        torch.set_num_threads(1)
        try:
            trainer = _train(sample, recipe, blocks, seed)
        finally:
            torch.set_num_threads(threads)
    steps = ", ".join(map(str, trainer.best_step))
    report(f"loss {trainer.loss:.4f} on blocks left out; kept steps {steps} of {trainer.steps}")
    return trainer.best(), trainer.predict_left_out(), recipe.settle_schedule(trainer.doubled)


def _train(sample: Sample, recipe: Recipe, blocks: list[NDArray[np.intp]], seed: int) -> _Trainer:
    best, doubled = None, 1
    while True:
        torch.manual_seed(seed)
        trainer = _Trainer(sample, recipe, blocks, doubled)
        trainer.run(np.random.default_rng(seed))
        gain = math.inf if best is None else best.loss - trainer.loss
        if best is None or gain > 0:
            best = trainer
        if gain < recipe.least_gain or math.isinf(recipe.least_gain):
            return best
        doubled *= 2


class _Trainer:
    """Trainer of all networks at once: parameters have a leading axis K."""

    def __init__(
        self, sample: Sample, recipe: Recipe, blocks: list[NDArray[np.intp]], doubled: int = 1
    ) -> None:
        self.recipe, self.blocks, self.doubled = recipe, blocks, doubled
        self.x = torch.as_tensor(sample.x, dtype=torch.float32)
        self.detected = torch.as_tensor(sample.detected, dtype=torch.float32)
        self.standard = torch.as_tensor(sample.standard, dtype=torch.float32)
        self.train_rows = [np.setdiff1d(np.arange(len(sample.x)), block) for block in blocks]
        widths = (sample.x.shape[1], *recipe.hidden, OUTPUTS)
        k = recipe.members
        self.weights = [self._initial(k, *pair) for pair in pairwise(widths)]
        with torch.no_grad():
            self.weights[-1] *= 0.1  # start near constant predictions
        self.biases = [torch.zeros(k, 1, width, requires_grad=True) for width in widths[1:]]
        self.freedom = torch.full((k, 1, 2), math.log(2.0), requires_grad=True)
        self._output_mask = torch.ones(OUTPUTS) if recipe.varying else torch.eye(OUTPUTS)[0]
        self.per_epoch = max(1, min(map(len, self.train_rows)) // self._batch)
        self.steps = doubled * max(recipe.epochs * self.per_epoch, recipe.least_steps)
        self.best_loss = [math.inf] * k
        self.best_step = [0] * k
        self._best_parameters: list[list[Tensor]] = [[] for _ in range(k)]

    @property
    def loss(self) -> float:
        """Mean loss of the networks on their blocks [nats per row]."""
        return float(np.mean(self.best_loss))

    @property
    def _batch(self) -> int:
        return min(self.recipe.batch, max(32, len(self.x) // 16))

    @staticmethod
    def _initial(k: int, rows: int, columns: int) -> Tensor:
        return (torch.randn(k, rows, columns) * math.sqrt(2 / rows)).requires_grad_()

    def run(self, rng: np.random.Generator) -> None:
        """Optimise, checking each network on its block after every pass."""
        decayed = {"params": self.weights, "weight_decay": self.recipe.decay}
        free = {"params": [*self.biases, self.freedom], "weight_decay": 0.0}
        optimiser = torch.optim.AdamW([decayed, free], lr=self.recipe.rate)
        for step, rows in zip(range(1, self.steps + 1), self._batches(rng), strict=False):
            for group in optimiser.param_groups:
                group["lr"] = self.recipe.rate * 0.5 * (1 + math.cos(math.pi * step / self.steps))
            optimiser.zero_grad()
            output = self.forward(self.x[rows], self.recipe.dropout)
            self._loss(output, rows, self.freedom).mean(dim=1).sum().backward()
            optimiser.step()
            if step % self.per_epoch == 0 or step == self.steps:
                self._check(step)

    def forward(self, x: Tensor, dropout: float = 0.0) -> Tensor:
        """Return (K, m, 5) outputs at (K, m, D) inputs."""
        for i, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            if i:
                x = torch.nn.functional.dropout(torch.relu(x), dropout)
            x = torch.baddbmm(bias, x, weight * self._output_mask if i == len(self.weights) - 1 else weight)
        return x

    def best(self) -> Networks:
        """Return the networks with the parameters that predict their blocks best."""
        layers = len(self.weights)
        parts = [torch.stack(part).double().numpy() for part in zip(*self._best_parameters, strict=True)]
        mask = self._output_mask.double().numpy()
        weights = (*parts[: layers - 1], parts[layers - 1] * mask)
        return networks(weights, tuple(part[:, 0] for part in parts[layers : 2 * layers]))

    def predict_left_out(self) -> Floats:
        """Return (n, 5) outputs of the network that has not seen the row."""
        best = self.best()
        out = np.empty((len(self.x), OUTPUTS))
        for k, block in enumerate(self.blocks):
            block_networks = networks(
                tuple(w[k : k + 1] for w in best.weights), tuple(b[k : k + 1] for b in best.biases)
            )
            out[block] = block_networks.predict(self.x[block].double().numpy())[0]
        return out

    def _batches(self, rng: np.random.Generator) -> Iterator[Tensor]:
        while True:
            orders = [rng.permutation(rows) for rows in self.train_rows]
            for i in range(self.per_epoch):
                part = slice(i * self._batch, (i + 1) * self._batch)
                yield torch.as_tensor(np.stack([order[part] for order in orders]))

    def _check(self, step: int) -> None:
        parameters = [*self.weights, *self.biases, self.freedom]
        for k, block in enumerate(self.blocks):
            rows = torch.as_tensor(block)
            with torch.no_grad():
                output = self._forward_member(k, self.x[rows])
                loss = float(self._loss(output, rows, self.freedom[k]).mean())
            if loss < self.best_loss[k]:
                self.best_loss[k], self.best_step[k] = loss, step
                self._best_parameters[k] = [parameter[k].detach().clone() for parameter in parameters]

    def _forward_member(self, k: int, x: Tensor) -> Tensor:
        for i, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            last = weight[k] * self._output_mask if i == len(self.weights) - 1 else weight[k]
            x = torch.addmm(bias[k], torch.relu(x) if i else x, last)
        return x

    def _loss(self, output: Tensor, rows: Tensor, freedom: Tensor) -> Tensor:
        detected = self.detected[rows]
        detection = torch.nn.functional.softplus(-output[..., 0] * (2 * detected - 1))
        dof = MIN_DOF + torch.exp(freedom)
        location, log_scale = output[..., 1:3], output[..., 3:5]
        z = (self.standard[rows] - location) * torch.exp(-log_scale)
        constant = torch.lgamma(dof / 2) - torch.lgamma((dof + 1) / 2) + 0.5 * torch.log(dof * math.pi)
        errors = constant + (dof + 1) / 2 * torch.log1p(z * z / dof) + log_scale
        return detection + detected * errors.sum(dim=-1)
