"""Policy controller: a network from observation to action, without memory."""

from __future__ import annotations

from importlib.metadata import entry_points
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from avrare.base.errors import UsageError, did_you_mean
from avrare.driving import ObservingEgo, Prediction
from avrare.protocols import Controller
from avrare_policy.config import PolicyConfig
from avrare_policy.network import Network, load
from avrare_policy.onnx_model import OnnxPolicy

GROUP = "avrare.policies"
"""Entry point group of shipped policies; values are the packages that hold ``models/NAME.npz``."""


class PolicyController(Controller):
    """Controller that runs a network on the ego's observation.

    Attributes:
        horizon: 0: it needs no predictions.
        network: The network.
        arrays: Weights and biases by name; none of an ONNX file.
        argmax: Whether the action is the number of the largest output, as in discrete action spaces.
    """

    horizon = 0

    def __init__(self, network: Network | OnnxPolicy, argmax: bool = False) -> None:
        self.network, self.argmax = network, argmax
        self.arrays = network.arrays if isinstance(network, Network) else {}

    def start(self, n: int) -> None:
        """Return None: it has no memory."""

    def act(
        self, memory: None, ego: object, prediction: Prediction | None
    ) -> tuple[NDArray[np.float64], None]:
        """Return actions (N, A) for observations (N, D): ``ego.observation``, or ``ego`` itself.

        Raises:
            UsageError: The simulator gives no observation, or one of another size.
        """
        observation = ego.observation if isinstance(ego, ObservingEgo) else ego
        if not isinstance(observation, np.ndarray) or observation.ndim != 2:
            raise UsageError(
                "the controller policy needs a simulator with observations of the ego",
                "such as highway_env with a `lidar:` block",
            )
        expected_size, size = self.network.inputs, observation.shape[1]
        if size != expected_size:
            raise UsageError(
                f"the policy needs observations of {expected_size} numbers, the simulator gives {size}",
                "configure the simulator's sensors as in the policy's model card",
            )
        action = self.network(observation)
        return (action.argmax(axis=1)[:, None].astype(np.float64) if self.argmax else action), None


def locate(model: str) -> Path:
    """Return the file of a shipped policy, or of a path that ends in ``.npz`` or ``.onnx``.

    Raises:
        UsageError: The policy or file does not exist.
    """
    if model.endswith((".npz", ".onnx")):
        path = Path(model)
        if not path.is_file():
            raise UsageError(f"{model}: no such file")
        return path
    shipped = {point.name: point.value for point in entry_points(group=GROUP)}
    if model not in shipped:
        hint = (
            did_you_mean(model, shipped)
            or "give a shipped policy's name or the path of an .npz or .onnx file"
        )
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
    """Build the controller of a scenario.

    Raises:
        UsageError: The policy is unknown, its file cannot be read, or ``arrays`` do not fit it.
    """
    path = locate(config.model)
    if path.suffix == ".onnx":
        for name in ("arrays", "gain"):
            if getattr(config, name) is not None:
                hint = "see `avrare policy convert`"
                raise UsageError(f"{config.model}: {name} is an option for .npz files", hint)
        return PolicyController(OnnxPolicy(path), config.output == "argmax")
    network = load(path).with_arrays(path, config.arrays or {})
    if config.gain is not None:
        network = network.with_gain(path, config.gain)
    return PolicyController(network, config.output == "argmax")
