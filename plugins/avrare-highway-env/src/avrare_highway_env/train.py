"""Training of the merge policy: ``python -m avrare_highway_env.train --out merge_lidar.npz``.

Imitation with data aggregation (Ross, Gordon and Bagnell, 2011): a mixture of the expert and the last round's
network drives, and every visited state is labelled with the expert's action.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import torch

from avrare.protocols import Floats
from avrare_highway_env.config import HighwayEnvConfig, LidarConfig, TrafficConfig
from avrare_highway_env.expert import Expert
from avrare_highway_env.simulator import HighwayEnvSimulator
from avrare_policy.network import Network, save

STEERING_GAIN = 10.0
"""Weight of the steering error, since steering is smaller than throttle."""


@dataclass(frozen=True)
class Plan:
    """Parameters of the training.

    Attributes:
        rounds: Rounds of driving and fitting; the expert's share halves every round.
        worlds: Worlds per round.
        steps: Steps per world.
        epochs: Epochs per fit.
        hidden: Units of each of the two hidden layers.
        speeds: 1: the network also receives the speeds measured by the lidar.
        batch: States per gradient step.
        rate: Initial learning rate of Adam; it falls to 0 along a cosine.
        jolt: Standard deviation of the action noise that leads to states off the lane.
        lidar_variance: Noise variance of the rays, normalised.
        mood: Standard deviation of the other drivers' accelerations [m/s^2].
        seed: Random seed.
    """

    rounds: int = 7
    worlds: int = 56
    steps: int = 190
    epochs: int = 12
    hidden: int = 128
    speeds: int = 0
    batch: int = 256
    rate: float = 1e-3
    jolt: float = 0.15
    lidar_variance: float = 0.0
    mood: float = 0.5
    seed: int = 1


def train(plan: Plan) -> Network:
    """Return the network after the last round."""
    torch.manual_seed(plan.seed)
    rng = np.random.default_rng(plan.seed)
    config = HighwayEnvConfig(
        scene="merge",
        lidar=LidarConfig(noise_variance=plan.lidar_variance, speeds=bool(plan.speeds)),
        traffic=TrafficConfig(acceleration_sd=plan.mood),
    )
    simulator, expert = HighwayEnvSimulator(config), Expert()
    states, labels = np.zeros((0, simulator.sensors.size)), np.zeros((0, 2))
    network = None
    for k in range(plan.rounds):
        share = 0.5**k
        observations, actions = _drive(plan, simulator, expert, network, share, rng)
        states, labels = np.concatenate([states, observations]), np.concatenate([labels, actions])
        network = _fit(plan, states, labels)
        error = np.sqrt(np.mean((network(states[-2000:]) - labels[-2000:]) ** 2, axis=0))
        print(f"round {k}: {len(states)} states, error of throttle {error[0]:.4f}, steering {error[1]:.4f}")
    assert network is not None
    return network


def _drive(
    plan: Plan,
    simulator: HighwayEnvSimulator,
    expert: Expert,
    network: Network | None,
    share: float,
    rng: np.random.Generator,
) -> tuple[Floats, Floats]:
    """Return visited states and the expert's actions; the expert drives ``share`` of the worlds."""
    n = plan.worlds
    by_expert = (np.arange(n) < share * n)[:, None]
    jolted = (rng.random(n) < 0.7)[:, None] * plan.jolt
    world = simulator.reset(rng.standard_normal((n, simulator.noise_size)))
    states, labels = [], []
    for _ in range(plan.steps):
        expert_action = expert.act(world.ego, world.others)
        states.append(world.ego.observation[~world.over])
        labels.append(expert_action[~world.over])
        action = (
            expert_action
            if network is None
            else np.where(by_expert, expert_action, network(world.ego.observation))
        )
        jolt = rng.standard_normal((n, 2)) * jolted * (1.0, 1.0 / STEERING_GAIN)
        noise = rng.standard_normal((n, simulator.noise_size))
        world = simulator.step(world, np.clip(action + jolt, -1.0, 1.0), noise)
    return np.concatenate(states), np.concatenate(labels)


def _fit(plan: Plan, states: Floats, labels: Floats) -> Network:
    mean, scale = states.mean(axis=0), np.maximum(states.std(axis=0), 0.05)
    inputs = torch.tensor((states - mean) / scale, dtype=torch.float32)
    gain = torch.tensor([1.0, STEERING_GAIN], dtype=torch.float32)
    targets = torch.tensor(labels, dtype=torch.float32) * gain
    sizes = (inputs.shape[1], plan.hidden, plan.hidden, 2)
    layers = [torch.nn.Linear(a, b, dtype=torch.float32) for a, b in pairwise(sizes)]
    net = torch.nn.Sequential(layers[0], torch.nn.Tanh(), layers[1], torch.nn.Tanh(), layers[2])
    optimiser = torch.optim.Adam(net.parameters(), lr=plan.rate)
    per_epoch = max(1, len(inputs) // plan.batch)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, plan.epochs * per_epoch)
    for _ in range(plan.epochs):
        for part in torch.randperm(len(inputs))[: per_epoch * plan.batch].view(per_epoch, -1):
            optimiser.zero_grad()
            torch.nn.functional.mse_loss(net(inputs[part]), targets[part]).backward()
            optimiser.step()
            schedule.step()
    return _export(plan, layers, mean, scale, gain.numpy(), len(states))


def _export(
    plan: Plan, layers: list[torch.nn.Linear], mean: Floats, scale: Floats, gain: Floats, states: int
) -> Network:
    weights = [layer.weight.detach().numpy().T.copy() for layer in layers]
    biases = [layer.bias.detach().numpy().copy() for layer in layers]
    weights[-1], biases[-1] = weights[-1] / gain, biases[-1] / gain
    provenance = {
        "source": "python -m avrare_highway_env.train",
        "expert": "intelligent driver model that overtakes, avrare_highway_env.expert",
        "plan": str(plan),
        "states": str(states),
        "license": "BSD-3-Clause",
    }
    return Network(
        tuple(weights),
        tuple(biases),
        "tanh",
        mean.astype(np.float32).astype(float),
        scale.astype(np.float32).astype(float),
        np.full(2, -1.0),
        np.full(2, 1.0),
        provenance,
    )


def main() -> None:
    """Train with the options of the command line and write the network."""
    parser = argparse.ArgumentParser(description="Train the merge policy by imitation.")
    parser.add_argument("--out", type=Path, required=True, help="file to write, .npz")
    for name, default in vars(Plan()).items():
        parser.add_argument(f"--{name.replace('_', '-')}", type=type(default), default=default)
    arguments = vars(parser.parse_args())
    out = arguments.pop("out")
    torch.set_num_threads(1)
    save(out, train(Plan(**arguments)))


if __name__ == "__main__":
    main()
