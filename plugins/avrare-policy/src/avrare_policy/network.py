"""Multilayer perceptron: its file format and its evaluation on a batch."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from avrare.base.errors import UsageError
from avrare.base.stored_files import parse_arrays, read_regular, write_arrays

Floats = NDArray[np.float64]
Arrays = Mapping[str, NDArray[np.generic]]
FORMAT = 1
SQUASHED = 2
"""Format of a network whose last layer is squashed, which version 0.1 cannot read."""
ACTIVATIONS: dict[str, Callable[[NDArray[np.float32]], NDArray[np.float32]]] = {
    "tanh": np.tanh,
    "relu": lambda values: np.maximum(values, np.float32(0.0)),
}


@dataclass(frozen=True)
class Network:
    """Fully connected network with the same activation after every layer but the last.

    Attributes:
        weights: Per layer (inputs, outputs), single precision.
        biases: Per layer (outputs,).
        activation: A key of ``ACTIVATIONS``.
        mean: (D,) subtracted from the observation.
        scale: (D,) divides it.
        low: (A,) least action.
        high: (A,) greatest action.
        provenance: Source, licence etc. by keyword.
        squash: Whether tanh squashes the last layer into [low, high], in place of clipping.
    """

    weights: tuple[NDArray[np.float32], ...]
    biases: tuple[NDArray[np.float32], ...]
    activation: str
    mean: Floats
    scale: Floats
    low: Floats
    high: Floats
    provenance: Mapping[str, str]
    squash: bool = False

    @property
    def inputs(self) -> int:
        """Numbers of an observation, D."""
        return len(self.mean)

    @property
    def arrays(self) -> dict[str, NDArray[np.float32]]:
        """Weights and biases by the names of the file: W0, b0, W1, ..."""
        pairs = zip(self.weights, self.biases, strict=True)
        return {
            name: array
            for k, pair in enumerate(pairs)
            for name, array in zip((f"W{k}", f"b{k}"), pair, strict=True)
        }

    def with_arrays(self, path: Path, arrays: Mapping[str, object]) -> Network:
        """Return the network with other weights and biases, by name.

        Raises:
            UsageError: A name or a shape does not fit, or a number is not finite.
        """
        current = self.arrays
        for name, values in arrays.items():
            if name not in current:
                raise UsageError(f"{path}: has no array {name!r}", f"it has {', '.join(current)}")
            shape = current[name].shape
            try:
                current[name] = np.ascontiguousarray(values, dtype=np.float32)
            except (TypeError, ValueError):
                raise UsageError(f"{path}: {name} needs numbers of shape {shape}") from None
            if current[name].shape != shape:
                raise UsageError(f"{path}: {name} needs numbers of shape {shape}, not {current[name].shape}")
        layers = range(len(self.weights))
        weights, biases = (tuple(current[f"{letter}{k}"] for k in layers) for letter in "Wb")
        changed = replace(self, weights=weights, biases=biases)
        _check(path, changed)
        return changed

    def with_gain(self, path: Path, gain: Sequence[float]) -> Network:
        """Return the network with factors on its outputs, those of the last layer.

        Raises:
            UsageError: There are not as many as outputs, or a product is not finite in single precision.
        """
        if len(gain) != len(self.low):
            raise UsageError(f"{path}: gain needs {len(self.low)} numbers, not {len(gain)}")
        if not np.all(np.abs(gain) <= np.finfo(np.float32).max):
            raise UsageError(f"{path}: gain needs finite numbers of single precision, not {list(gain)}")
        factors = np.asarray(gain, dtype=np.float32)
        *weights, weight = self.weights
        *biases, bias = self.biases
        with np.errstate(over="ignore"):
            weight, bias = weight * factors, bias * factors
        if not (np.isfinite(weight).all() and np.isfinite(bias).all()):
            text = f"{path}: gain makes the last layer not finite in single precision: {list(gain)}"
            raise UsageError(text, "look at `gain` and `arrays`")
        return replace(self, weights=(*weights, weight), biases=(*biases, bias))

    def __call__(self, observation: Floats) -> Floats:
        """Return actions (N, A) of observations (N, D), within their range.

        Products are einsum: with BLAS the last bits of a row would depend on its neighbours.
        """
        activate = ACTIVATIONS[self.activation]
        values = ((observation - self.mean) / self.scale).astype(np.float32)
        last = len(self.weights) - 1
        for k, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            values = np.einsum("ni,ij->nj", values, weight) + bias
            values = values if k == last else activate(values)
        if self.squash:
            return self.low + 0.5 * (np.tanh(values.astype(np.float64)) + 1.0) * (self.high - self.low)
        return np.clip(values.astype(np.float64), self.low, self.high)


def load(path: Path) -> Network:
    """Read a network.

    Raises:
        UsageError: The file was not written by ``save``.
    """
    try:
        return _assemble(path, parse_arrays(read_regular(path)))
    except KeyError as error:
        raise UsageError(f"{path}: not a policy: {error.args[0]!r} is missing") from None
    except (ValueError, OSError, TypeError, LookupError, ArithmeticError) as error:
        raise UsageError(f"{path}: not a policy: {error}") from None


def save(path: Path, network: Network) -> None:
    """Write a network: ``W0``, ``b0``, ``W1``, ..., never pickled."""
    arrays: dict[str, NDArray[np.generic]] = {
        "format": np.array(SQUASHED if network.squash else FORMAT),
        "activation": np.array(network.activation),
        "provenance_keys": np.array(list(network.provenance), dtype=np.str_),
        "provenance_values": np.array(list(network.provenance.values()), dtype=np.str_),
    }
    arrays |= {name: getattr(network, name) for name in ("mean", "scale", "low", "high")}
    for k, (weight, bias) in enumerate(zip(network.weights, network.biases, strict=True)):
        arrays |= {f"W{k}": weight.astype(np.float32), f"b{k}": bias.astype(np.float32)}
    write_arrays(path, arrays)


def _assemble(path: Path, arrays: Arrays) -> Network:
    file_format = int(arrays["format"].astype(float))
    if file_format not in (FORMAT, SQUASHED):
        raise UsageError(f"{path}: policy format {file_format}, this version reads {FORMAT} and {SQUASHED}")
    layers = sum(name.startswith("W") and name[1:].isdigit() for name in arrays)
    keys, values = arrays["provenance_keys"], arrays["provenance_values"]
    network = Network(
        weights=tuple(np.ascontiguousarray(arrays[f"W{k}"], np.float32) for k in range(layers)),
        biases=tuple(np.ascontiguousarray(arrays[f"b{k}"], np.float32) for k in range(layers)),
        activation=str(arrays["activation"]),
        mean=np.asarray(arrays["mean"], float),
        scale=np.asarray(arrays["scale"], float),
        low=np.asarray(arrays["low"], float),
        high=np.asarray(arrays["high"], float),
        provenance={str(key): str(value) for key, value in zip(keys, values, strict=True)},
        squash=file_format == SQUASHED,
    )
    _check(path, network)
    return network


def _check(path: Path, network: Network) -> None:
    if network.activation not in ACTIVATIONS:
        raise UsageError(
            f"{path}: unknown activation {network.activation!r}", f"known: {', '.join(ACTIVATIONS)}"
        )
    sizes = [len(network.mean)]
    for k, (weight, bias) in enumerate(zip(network.weights, network.biases, strict=True)):
        if weight.shape != (sizes[-1], len(bias)):
            raise UsageError(f"{path}: W{k} has shape {weight.shape}, {(sizes[-1], len(bias))} is needed")
        sizes.append(len(bias))
    vectors = {"scale": sizes[0], "low": sizes[-1], "high": sizes[-1]}
    for name, size in vectors.items():
        if getattr(network, name).shape != (size,):
            raise UsageError(f"{path}: {name} needs {size} entries")
    finite = [np.isfinite(values).all() for values in (*network.weights, *network.biases)]
    finite += [np.isfinite(getattr(network, name)).all() for name in ("mean", "scale")]
    bounds = (network.low, network.high)
    finite += [np.isfinite(bound).all() if network.squash else not np.isnan(bound).any() for bound in bounds]
    if len(sizes) == 1:
        raise UsageError(f"{path}: a policy needs at least one layer")
    if not all(finite):
        raise UsageError(f"{path}: a weight, bias, mean, scale or bound is not finite")
    if (network.scale <= 0.0).any():
        raise UsageError(f"{path}: scale must be positive")
