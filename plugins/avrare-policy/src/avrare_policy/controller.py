"""A network as a controller: observation in, action out, no memory."""

from __future__ import annotations

from importlib.metadata import entry_points
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from avrare.driving import Prediction
from avrare.errors import UsageError, did_you_mean
from avrare_policy.config import PolicyConfig
from avrare_policy.network import Network, load

GROUP = "avrare.policies"
"""Entry points of this group name policies; their values are the packages with ``models/NAME.npz``."""


class PolicyController:
    """Runs a network on what the ego observes.

    Attributes:
        horizon: 0, it needs no predictions.
        network: The network.
    """

    horizon = 0

    def __init__(self, network: Network) -> None:
        self.network = network

    def start(self, n: int) -> None:
        """There is no memory."""
        return

    def act(self, memory: None, ego: Any, prediction: Prediction | None) -> tuple[NDArray[np.float64], None]:
        """Actions (N, A) from ``ego.observation`` (N, D), or from ``ego`` where that is the observation.

        Raises:
            UsageError: The simulator hands out no observation, or one of another size.
        """
        observation = getattr(ego, "observation", ego)
        if not isinstance(observation, np.ndarray) or observation.ndim != 2:
            raise UsageError(
                "the controller policy needs a simulator whose ego observes something",
                "such as highway_env with a `lidar:` block",
            )
        wanted = len(self.network.mean)
        if observation.shape[1] != wanted:
            raise UsageError(
                f"the policy was made for {wanted} observed numbers, it is given {observation.shape[1]}",
                "let the simulator's sensors be those of the policy's model card",
            )
        return self.network(observation), None


def locate(model: str) -> Path:
    """The file of a shipped policy's name, or of a path that ends in ``.npz``.

    Raises:
        UsageError: There is no such policy or file.
    """
    if model.endswith(".npz"):
        path = Path(model)
        if not path.is_file():
            raise UsageError(f"{model}: no such file")
        return path
    shipped = {point.name: point.value for point in entry_points(group=GROUP)}
    if model not in shipped:
        hint = did_you_mean(model, shipped) or "give a shipped policy's name or the path of an .npz file"
        raise UsageError(f"unknown policy {model!r}", hint)
    spec = find_spec(shipped[model])
    folders = list(spec.submodule_search_locations or []) if spec is not None else []
    for folder in folders:
        path = Path(folder) / "models" / f"{model}.npz"
        if path.is_file():
            return path
    raise UsageError(
        f"policy {model!r} is not in {shipped[model]}", f"pip install --upgrade {shipped[model]}"
    )


def build(config: PolicyConfig, scene: object | None = None) -> PolicyController:
    """The controller of a scenario.

    Raises:
        UsageError: The policy is unknown or its file cannot be read.
    """
    return PolicyController(load(locate(config.model)))
