"""Conversion of trained networks to the plugin's own file: torch state dicts and stable-baselines3 archives.

Only tensors are read (``torch.load(weights_only=True)``); nothing in the file is executed.
"""

from __future__ import annotations

import io
import re
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from avrare.base.errors import PluginError, UsageError
from avrare.base.stored_files import read_regular
from avrare_policy.network import Network

Weights = Mapping[str, NDArray[np.float32]]
_Layers = list[tuple[NDArray[np.float32], NDArray[np.float32]]]


@dataclass(frozen=True)
class Layout:
    """Names of a policy's layers in a state dict, and the prefixes of its library."""

    name: str
    pattern: str  # of the layers' names, in the order of the network
    activation: str
    squash: bool


LAYOUTS = (
    Layout("PPO or A2C of stable-baselines3", r"mlp_extractor\.policy_net\.\d+|action_net", "tanh", False),
    Layout("SAC of stable-baselines3", r"actor\.latent_pi\.\d+|actor\.mu", "relu", True),
    Layout("TD3 or DDPG of stable-baselines3", r"actor\.mu\.\d+", "relu", True),
    Layout("DQN of stable-baselines3", r"q_net\.q_net\.\d+", "relu", False),
    Layout("torch", r".*", "tanh", False),
)


def convert(
    path: Path,
    *,
    activation: str | None = None,
    low: float = -np.inf,
    high: float = np.inf,
    squash: bool | None = None,
) -> tuple[Network, Layout]:
    """Read the network of a policy.

    Args:
        path: ``.zip`` of stable-baselines3, or a state dict (``.pt``, ``.pth``) of linear layers.
        activation: "tanh" or "relu"; None: the default of the library.
        low: Least action.
        high: Largest action.
        squash: Whether tanh squashes the last layer into [low, high]; None: as the library does.

    Returns:
        The network, and how its file was understood.

    Raises:
        PluginError: torch is not installed.
        UsageError: The file is another policy.
    """
    layout, layers = _find_layers(path)
    matrices = tuple(matrix for matrix, _ in layers)
    sizes = [matrix.shape for matrix in matrices]
    if any(before[1] != after[0] for before, after in pairwise(sizes)):
        chain = ", ".join(f"{rows} -> {columns}" for rows, columns in sizes)
        raise UsageError(f"{path}: its linear layers do not form a chain: {chain}", "convert a plain network")
    squashed = layout.squash if squash is None else squash
    if squashed and not (np.isfinite(low) and np.isfinite(high)):
        low, high = -1.0, 1.0
    inputs, actions = sizes[0][0], sizes[-1][1]
    provenance = {"source": path.name, "read as": layout.name}
    network = Network(
        matrices,
        tuple(bias for _, bias in layers),
        activation or layout.activation,
        np.zeros(inputs),
        np.ones(inputs),
        np.full(actions, low),
        np.full(actions, high),
        provenance,
        squashed,
    )
    return network, layout


def _find_layers(path: Path) -> tuple[Layout, _Layers]:
    weights = _read(path)
    for layout in LAYOUTS:
        if layers := _layers(weights, layout.pattern):
            return layout, layers
    raise UsageError(f"{path}: has no linear layers", "a policy is a chain of linear layers")


def _read(path: Path) -> Weights:
    try:
        import torch
    except ImportError:
        raise PluginError(f"{path}: reading it needs torch", "pip install torch") from None
    content = read_regular(path)
    try:
        if zipfile.is_zipfile(io.BytesIO(content)):
            with zipfile.ZipFile(io.BytesIO(content)) as archive:
                if "policy.pth" in archive.namelist():  # a state dict is a zip archive, too
                    most_bytes = 512 * 2**20
                    if archive.getinfo("policy.pth").file_size > most_bytes:
                        raise UsageError(f"{path}: policy.pth is larger than {most_bytes >> 20} MiB")
                    content = archive.read("policy.pth")
        tensors = torch.load(io.BytesIO(content), map_location="cpu", weights_only=True)
    except UsageError:
        raise
    except Exception as error:  # pickle, zip and torch have many
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        hint = "save the state dict: torch.save(policy.state_dict(), 'policy.pt')"
        raise UsageError(f"{path}: cannot be read as tensors: {reason}", hint) from None
    if not isinstance(tensors, Mapping):
        raise UsageError(f"{path}: has no state dict", "torch.save(policy.state_dict(), 'policy.pt')")
    return {str(name): _array(value) for name, value in tensors.items() if hasattr(value, "detach")}


def _array(tensor: Any) -> NDArray[np.float32]:
    return np.asarray(tensor.detach().float().numpy(), dtype=np.float32)


def _layers(weights: Weights, pattern: str) -> _Layers:
    layers = []
    for name, matrix in weights.items():
        layer = re.fullmatch(rf"({pattern})\.weight", name)
        if layer and matrix.ndim == 2:
            bias = weights.get(f"{layer[1]}.bias", np.zeros(len(matrix), dtype=np.float32))
            layers.append((np.ascontiguousarray(matrix.T), bias))
    return layers
