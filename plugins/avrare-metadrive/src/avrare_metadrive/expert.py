"""The driver that comes with MetaDrive: a network of 275-256-256-2, trained by its authors with PPO.

Its weights are under Apache-2.0. They are read where pip has put them, and not copied.
"""

from __future__ import annotations

import zipfile
from importlib.metadata import distribution
from pathlib import Path

import numpy as np

from avrare.errors import PluginError
from avrare_metadrive import version
from avrare_metadrive.config import ExpertConfig
from avrare_policy.controller import PolicyController
from avrare_policy.network import Network

WEIGHTS = "metadrive/examples/ppo_expert/expert_weights.npz"
OTHERS = 4
"""Nearest vehicles that it is told of, without noise."""
MIRRORED = (10, 15)
"""Entries that MetaDrive has turned round since the training: which way the next two lanes bend."""
PROVENANCE = {
    "source": f"metadrive-simulator {version.CHECKED}, {WEIGHTS}",
    "license": "Apache-2.0",
    "sha256": "ed66fed9ecfbe7c1acd18a9d95c659119892dcc773758f40849c3390c6f38eaf",
}
_LAYERS = ("fc_1", "fc_2", "fc_out")


def build(config: ExpertConfig, scene: object | None = None) -> PolicyController:
    """The controller of a scenario.

    Raises:
        PluginError: The MetaDrive with these weights is not installed.
    """
    return PolicyController(read(locate()))


def locate() -> Path:
    """Where the weights are; MetaDrive itself is not imported.

    Raises:
        PluginError: They are not there.
    """
    version.require()
    path = Path(str(distribution("metadrive-simulator").locate_file(WEIGHTS)))
    if path.is_file():
        return path
    raise PluginError("MetaDrive's expert_weights.npz is not there", version.HINT)


def read(path: Path) -> Network:
    """The network of MetaDrive's weights: its mean action, steering and throttle in [-1, 1].

    Raises:
        PluginError: The file does not hold them.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            weights = [np.asarray(file[f"default_policy/{name}/kernel"], np.float32) for name in _LAYERS]
            biases = [np.asarray(file[f"default_policy/{name}/bias"], np.float32) for name in _LAYERS]
    except (KeyError, ValueError, OSError, EOFError, zipfile.BadZipFile) as error:
        raise PluginError(f"{path}: not MetaDrive's expert: {error}", version.HINT) from None
    actions = len(biases[-1]) // 2  # the other half are logarithms of standard deviations
    weights[-1], biases[-1] = np.ascontiguousarray(weights[-1][:, :actions]), biases[-1][:actions]
    # (o - 1) / -1 = 1 - o
    mean, scale = np.zeros(len(weights[0])), np.ones(len(weights[0]))
    mean[list(MIRRORED)], scale[list(MIRRORED)] = 1.0, -1.0
    ends = np.full(actions, -1.0), np.full(actions, 1.0)
    return Network(tuple(weights), tuple(biases), "tanh", mean, scale, *ends, PROVENANCE)
