"""Expert driver of MetaDrive: a 275-256-256-2 network, trained by its authors with PPO.

The weights (Apache-2.0) are read from the installed package, not copied.
"""

from __future__ import annotations

import zipfile
from importlib.metadata import distribution
from pathlib import Path

import numpy as np

from avrare.base.errors import PluginError
from avrare_metadrive import version
from avrare_metadrive.config import ExpertConfig
from avrare_policy.controller import PolicyController
from avrare_policy.network import Network

WEIGHTS = "metadrive/examples/ppo_expert/expert_weights.npz"
OTHERS = 4
"""Number of nearest vehicles in the observation, without noise."""
PROVENANCE = {
    "source": f"metadrive-simulator {version.CHECKED}, {WEIGHTS}",
    "license": "Apache-2.0",
    "sha256": "ed66fed9ecfbe7c1acd18a9d95c659119892dcc773758f40849c3390c6f38eaf",
}


def build(config: ExpertConfig, scene: object | None = None) -> PolicyController:
    """Build the controller of a scenario.

    Raises:
        PluginError: The supported version of MetaDrive is not installed.
    """
    return PolicyController(read(locate()))


def locate() -> Path:
    """Return the path of the weights without importing MetaDrive.

    Raises:
        PluginError: The file does not exist.
    """
    version.check_supported()
    path = Path(str(distribution("metadrive-simulator").locate_file(WEIGHTS)))
    if path.is_file():
        return path
    raise PluginError("MetaDrive's expert_weights.npz is missing", version.HINT)


def read(path: Path) -> Network:
    """Read the network of the mean action (steering and throttle in [-1, 1]).

    Raises:
        PluginError: The file does not contain the weights.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            layers = ("fc_1", "fc_2", "fc_out")
            weights = [np.asarray(file[f"default_policy/{name}/kernel"], np.float32) for name in layers]
            biases = [np.asarray(file[f"default_policy/{name}/bias"], np.float32) for name in layers]
    except (KeyError, ValueError, OSError, EOFError, zipfile.BadZipFile) as error:
        raise PluginError(f"{path}: not MetaDrive's expert: {error}", version.HINT) from None
    actions = len(biases[-1]) // 2  # the other half: logarithms of standard deviations
    weights[-1], biases[-1] = np.ascontiguousarray(weights[-1][:, :actions]), biases[-1][:actions]
    # (o - 1) / -1 = 1 - o
    mean, scale = np.zeros(len(weights[0])), np.ones(len(weights[0]))
    mirrored = (10, 15)  # directions of the next two curves, whose sign MetaDrive changed after the training
    mean[list(mirrored)], scale[list(mirrored)] = 1.0, -1.0
    ends = np.full(actions, -1.0), np.full(actions, 1.0)
    return Network(tuple(weights), tuple(biases), "tanh", mean, scale, *ends, PROVENANCE)
