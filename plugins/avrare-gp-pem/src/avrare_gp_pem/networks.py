"""Small feed-forward networks whose mean is the model: inference in NumPy from exported arrays.

K networks of the same shape, trained apart, are averaged. None, one or more hidden layers of rectified linear
units: with none this is a generalised linear model, so that one form serves them all. They were trained in
single precision and are evaluated in it: it halves the time, and moves a probability by less than 1e-5.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]

_BLOCK = 48  # rows per product, always: a row must have the same last bits in any batch and place (see gp.py)
_TILE = 16  # columns of products are whole numbers of these
_TOGETHER = 4  # blocks per stacked product: what they need stays in the cache


@dataclass(frozen=True)
class Networks:
    """K networks of D inputs and O outputs; make it with ``networks``. All arrays are read-only.

    Attributes:
        weights: One array per layer, (K, in, out).
        biases: One per layer, (K, out).
        padded: The same arrays with columns filled up with zeros to whole tiles; layer 0 holds the K networks
            side by side.
    """

    weights: tuple[Floats, ...]
    biases: tuple[Floats, ...]
    padded: tuple[tuple[Singles, Singles], ...]

    @property
    def outputs(self) -> int:
        """O."""
        return int(self.biases[-1].shape[1])

    def predict(self, x: Floats) -> tuple[Floats, Floats]:
        """Mean over the networks, and a variance of zero (see ``store.Latents``).

        Args:
            x: (n, D) normalised inputs.

        Returns:
            (n, O) means and zeros; a row depends on its own input only, to the last bit.
        """
        count = len(x)
        blocks = np.zeros((-(-count // _BLOCK), _BLOCK, x.shape[1]), np.float32)
        blocks.reshape(-1, x.shape[1])[:count] = x
        out = np.empty((*blocks.shape[:2], self.outputs))
        for i in range(0, len(blocks), _TOGETHER):
            part = slice(i, i + _TOGETHER)
            out[part] = self._blocks(blocks[part])
        mean = out.reshape(-1, self.outputs)[:count]
        return mean, np.zeros_like(mean)

    def _blocks(self, x: Singles) -> Singles:
        first, bias = self.padded[0]
        members = len(self.biases[0])
        side_by_side = x @ first
        side_by_side += bias
        hidden = side_by_side.reshape(*x.shape[:2], members, -1).transpose(0, 2, 1, 3)  # (b, K, rows, width)
        for weight, bias in self.padded[1:]:
            hidden = np.maximum(hidden, np.float32(0.0)) @ weight
            hidden += bias
        return hidden[..., : self.outputs].sum(axis=1) / np.float32(members)  # type: ignore[no-any-return]


def networks(weights: tuple[Floats, ...], biases: tuple[Floats, ...]) -> Networks:
    """The networks of these parameters (see ``Networks``).

    Raises:
        ValueError: The layers do not fit each other.
    """
    width = weights[0].shape[1]
    for weight, bias in zip(weights, biases, strict=True):
        if weight.shape[1] != width or bias.shape != (len(weights[0]), weight.shape[2]):
            raise ValueError("the layers of the networks do not fit each other")
        width = weight.shape[2]
    layers = [
        _fill(weight, bias, first=i == 0)
        for i, (weight, bias) in enumerate(zip(weights, biases, strict=True))
    ]
    first, start = layers[0]
    side_by_side = np.ascontiguousarray(first.transpose(1, 0, 2)).reshape(first.shape[1], -1)
    return Networks(weights, biases, ((side_by_side, start.reshape(-1)), *layers[1:]))


def _fill(weight: Floats, bias: Floats, *, first: bool) -> tuple[Singles, Singles]:
    """A layer with its columns, and all but the first with its rows too, filled up to whole tiles."""
    columns = -weight.shape[2] % _TILE
    rows = 0 if first else -weight.shape[1] % _TILE
    filled = np.pad(weight.astype(np.float32), ((0, 0), (0, rows), (0, columns)))
    return filled, np.pad(bias.astype(np.float32), ((0, 0), (0, columns)))[:, None, :]
