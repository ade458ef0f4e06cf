"""A small network that balances the pendulum, to be improved by ``avrare synthesise`` (docs/synthesis.md).

    python benchmarks/small_policy.py FOLDER

writes ``pendulum.npz``, a network 3-4-1 (tanh) whose hidden units see disturbed copies of a PD command, and
``pendulum_policy.yaml``, the pendulum of ``scenarios/`` with this network in the place of its PD controller.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import avrare
from avrare.scenario.yaml import dump
from avrare_policy.network import Network, save

SCENARIOS = Path(__file__).parents[1] / "scenarios"
_GAIN = np.array([0.0, 12.0, 3.0])
"""Of height, side and rate, as in ``scenarios/pendulum.yaml`` [N m]."""
_HIDDEN = 4


def network(seed: int = 0) -> Network:
    """Return the network: hidden units see noisy copies of the PD command, and their mean is the torque."""
    rng = np.random.default_rng(seed)
    seen = _GAIN / 1.5 + rng.normal(0.0, 0.1, size=(_HIDDEN, 3))
    weights = (seen.T.astype(np.float32), np.full((_HIDDEN, 1), -2.0 / _HIDDEN, np.float32))
    biases = (np.zeros(_HIDDEN, np.float32), np.zeros(1, np.float32))
    low, high = np.array([-2.0]), np.array([2.0])
    return Network(
        weights, biases, "tanh", np.zeros(3), np.ones(3), low, high, {"source": Path(__file__).name}
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    folder = parser.parse_args().folder
    folder.mkdir(parents=True, exist_ok=True)
    save(folder / "pendulum.npz", network())
    scenario = avrare.load(SCENARIOS / "pendulum.yaml").definition.resolved
    controller = {"plugin": "policy", "model": str(folder.absolute() / "pendulum.npz")}
    changed = {**scenario, "name": "pendulum_policy", "controller": controller}
    (folder / "pendulum_policy.yaml").write_text(dump(changed))


if __name__ == "__main__":
    main()
