"""Ensembles of small feed-forward networks: inference in NumPy from exported arrays.

The model is the mean of K networks of the same shape, trained separately. Hidden layers are rectified linear
units; without any, the model is a generalised linear one. The networks were trained in single precision and
are evaluated in it: this halves the time and moves a probability by less than 1e-5.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from avrare.protocols import Floats
from avrare_gp_pem.runtime.blocks import evaluate_in_blocks

Singles = NDArray[np.float32]


@dataclass(frozen=True)
class Networks:
    """K networks of D inputs and O outputs; create it with ``networks``. All arrays are read-only.

    Attributes:
        weights: One array per layer, (K, in, out).
        biases: One array per layer, (K, out).
        padded: The same in single precision with columns padded to whole tiles; layer 0 holds the K networks
            side by side.
    """

    weights: tuple[Floats, ...]
    biases: tuple[Floats, ...]
    padded: tuple[tuple[Singles, Singles], ...]

    def predict(self, x: Floats) -> tuple[Floats, Floats]:
        """Return the mean over the networks, and a variance of zero (see ``variant.Latents``).

        Args:
            x: (n, D) normalised inputs.

        Returns:
            (n, O) means and zeros; a row depends on its own input only, to the last bit.
        """
        outputs = self.biases[-1].shape[1]
        mean = evaluate_in_blocks(self._mean, x.astype(np.float32), outputs, 24)
        return mean, np.zeros_like(mean)

    def _mean(self, x: Singles) -> Singles:
        members, outputs = self.biases[-1].shape
        first, bias = self.padded[0]
        side_by_side = x @ first
        side_by_side += bias
        hidden = side_by_side.reshape(*x.shape[:2], members, -1).transpose(0, 2, 1, 3)  # (b, K, rows, width)
        for weight, bias in self.padded[1:]:
            hidden = np.maximum(hidden, np.float32(0.0)) @ weight
            hidden += bias
        mean: Singles = hidden[..., :outputs].sum(axis=1) / np.float32(members)
        return mean


def networks(weights: tuple[Floats, ...], biases: tuple[Floats, ...]) -> Networks:
    """Create the networks with these parameters (see ``Networks``).

    Raises:
        ValueError: The shapes of the layers do not match.
    """
    width = weights[0].shape[1]
    for weight, bias in zip(weights, biases, strict=True):
        if weight.shape[1] != width or bias.shape != (len(weights[0]), weight.shape[2]):
            raise ValueError("the shapes of the networks' layers do not match")
        width = weight.shape[2]
    first, *layers = (
        _pad(weight, bias, first=i == 0) for i, (weight, bias) in enumerate(zip(weights, biases, strict=True))
    )
    side_by_side = np.ascontiguousarray(first[0].transpose(1, 0, 2)).reshape(first[0].shape[1], -1)
    return Networks(weights, biases, ((side_by_side, first[1].reshape(-1)), *layers))


def _pad(weight: Floats, bias: Floats, *, first: bool) -> tuple[Singles, Singles]:
    tile = 16
    columns = -weight.shape[2] % tile
    rows = 0 if first else -weight.shape[1] % tile
    padded = np.pad(weight.astype(np.float32), ((0, 0), (0, rows), (0, columns)))
    return padded, np.pad(bias.astype(np.float32), ((0, 0), (0, columns)))[:, None, :]
