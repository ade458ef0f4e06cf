"""Fitted flow: physical noise from standard normal numbers, with its exact density.

The invertible blocks of a flow agree with Pyro's transforms of the same names (Dinh et al. 2017; Durkan et
al. 2019; Germain et al. 2015). Products are einsum without BLAS: no row depends on its neighbours.
"""

# ruff: noqa: D102 - ``Block`` documents the methods of all blocks.

from __future__ import annotations

import zipfile
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from avrare.base.errors import UsageError
from avrare.base.stored_files import parse_arrays, read_regular, write_arrays
from avrare.protocols import Floats
from avrare_flows.health_messages import WARNINGS

KINDS = ("affine_coupling", "spline_autoregressive")
_FORMAT = 1
_DAMAGED = (
    ValueError,
    LookupError,
    EOFError,
    TypeError,
    AttributeError,
    ArithmeticError,
    NotImplementedError,
    RuntimeError,
    zipfile.BadZipFile,
    zlib.error,
)
"""Exceptions of reading a file that is not a flow, or a damaged one."""
_LEAST, _MOST = -5.0, 3.0
"""Bounds of an affine coupling's log scale."""
_LEAST_BIN, _LEAST_SLOPE, _EPSILON = 1e-3, 1e-3, 1e-6
"""Least width of a spline's bins (over that of all) and least slope; tolerance of a bin's start."""

Warped = tuple[Floats, Floats]
"""Rows (N, n), and log |det| (N,) of the map's derivative."""


class Block(Protocol):
    """A step of a flow."""

    def push(self, x: Floats) -> Warped:
        """Map rows (N, n) one step towards physical ones; return them and log |det| (N,)."""


@dataclass(frozen=True, eq=False)
class Network:
    """Multilayer perceptron with rectified linear units.

    Attributes:
        weights: (out, in) of each layer.
        biases: (out,) of each layer.
    """

    weights: tuple[Floats, ...]
    biases: tuple[Floats, ...]

    def __call__(self, x: Floats) -> Floats:
        """Return outputs (N, out) of inputs (N, in)."""
        for weight, bias in zip(self.weights[:-1], self.biases[:-1], strict=True):
            x = np.maximum(np.einsum("ni,oi->no", x, weight) + bias, 0.0)
        return np.asarray(np.einsum("ni,oi->no", x, self.weights[-1]) + self.biases[-1])


@dataclass(frozen=True, eq=False)
class AffineCoupling:
    """Shift and scale the last numbers of a row as a function of the first n // 2; then reverse the row.

    Attributes:
        network: From the first numbers to means and log scales of the others.
    """

    network: Network

    def push(self, x: Floats) -> Warped:
        half = x.shape[1] // 2
        mean, log_scale = np.split(self.network(x[:, :half]), 2, axis=1)
        log_scale = np.clip(log_scale, _LEAST, _MOST)
        moved = np.exp(log_scale) * x[:, half:] + mean
        return np.concatenate([x[:, :half], moved], axis=1)[:, ::-1], log_scale.sum(axis=1)


@dataclass(frozen=True, eq=False)
class SplineAutoregressive:
    """Map each number by a rational quadratic spline that depends on the numbers before it.

    Attributes:
        network: Masked network from a row to (3 bins - 1) x n parameters.
        bound: The spline is the identity beyond it.
    """

    network: Network
    bound: float

    def push(self, x: Floats) -> Warped:
        raw = self.network(x).reshape(len(x), -1, x.shape[1])
        bins = (raw.shape[1] + 1) // 3
        widths, heights, slopes = np.split(raw.transpose(0, 2, 1), [bins, 2 * bins], axis=2)
        knots = _knots(widths, self.bound), _knots(heights, self.bound)
        return _spline(x, *knots, _LEAST_SLOPE + np.logaddexp(slopes, 0.0), self.bound)


def _knots(raw: Floats, bound: float) -> Floats:
    share = np.exp(raw - raw.max(axis=2, keepdims=True))
    share /= share.sum(axis=2, keepdims=True)
    bins = raw.shape[2]
    inner = np.cumsum(_LEAST_BIN + (1.0 - _LEAST_BIN * bins) * share, axis=2)[..., :-1]
    ends = np.full((*raw.shape[:2], 1), bound)
    return np.concatenate([-ends, 2.0 * bound * inner - bound, ends], axis=2)


def _spline(x: Floats, across: Floats, up: Floats, inner: Floats, bound: float) -> Warped:
    """Evaluate the spline through the knots (across, up) with slopes ``inner`` (N, n, bins - 1)."""
    end = np.full((*x.shape, 1), 1.0 - _LEAST_SLOPE)
    slopes = np.concatenate([end, inner, end], axis=2)
    place = np.clip((x[..., None] >= across + _EPSILON).sum(axis=2) - 1, 0, across.shape[2] - 2)

    def at(values: Floats, offset: int = 0) -> Floats:
        return np.take_along_axis(values, place[..., None] + offset, axis=2)[..., 0]

    width, height = at(across, 1) - at(across), at(up, 1) - at(up)
    chord, first, last = height / width, at(slopes), at(slopes, 1)
    t = (np.clip(x, -bound, bound) - at(across)) / width
    both = t * (1.0 - t)
    below = chord + (first + last - 2.0 * chord) * both
    inside = np.abs(x) <= bound
    value = np.where(inside, at(up) + height * (chord * t**2 + first * both) / below, x)
    rise = chord**2 * (last * t**2 + 2.0 * chord * both + first * (1.0 - t) ** 2)
    log_slope = np.where(inside, np.log(rise) - 2.0 * np.log(below), 0.0)
    return value, log_slope.sum(axis=1)


@dataclass(frozen=True, eq=False)
class Flow:
    """An ``avrare_flows.laws.Law``: a chain of blocks, then shift + scale x.

    Attributes:
        kind: One of ``KINDS``, or the origin of a flow that was not fitted.
        blocks: From normal to nearly physical numbers.
        shift: (n,).
        scale: (n,) positive.
        samples: Number of samples that it was fitted to; 0: not fitted.
    """

    kind: str
    blocks: tuple[Block, ...]
    shift: Floats
    scale: Floats
    samples: int = 0

    @property
    def noise_size(self) -> int:
        """Number of numbers of a row."""
        return len(self.shift)

    @property
    def note(self) -> str:
        """Health warning ``model_error`` of every result."""
        return WARNINGS["model_error"].format(samples=self.samples)

    def warp(self, z: Floats) -> Warped:
        """Return physical rows of standard normal rows (N, n), and log |det dx/dz| (N,)."""
        x, log_det = z, np.zeros(len(z))
        for block in self.blocks:
            x, part = block.push(x)
            log_det = log_det + part
        return np.ascontiguousarray(self.shift + self.scale * x), log_det + float(np.log(self.scale).sum())

    def physical(self, z: Floats) -> Floats:
        """Return physical rows of standard normal rows (N, n)."""
        return self.warp(z)[0]

    def save(self, path: str | Path) -> None:
        """Write a file for ``load``: arrays only.

        Raises:
            UsageError: The file cannot be written.
        """
        arrays: dict[str, Any] = {
            "format": _FORMAT,
            "kind": self.kind,
            "shift": self.shift,
            "scale": self.scale,
            "samples": self.samples,
            "blocks": len(self.blocks),
        }
        for i, block in enumerate(self.blocks):
            if not isinstance(block, AffineCoupling | SplineAutoregressive):
                raise UsageError(f"a {type(block).__name__} cannot be written to a file")
            if isinstance(block, SplineAutoregressive):
                arrays[f"{i}.bound"] = block.bound
            network = block.network
            for j, (weight, bias) in enumerate(zip(network.weights, network.biases, strict=True)):
                arrays[f"{i}.weight{j}"], arrays[f"{i}.bias{j}"] = weight, bias
        try:
            write_arrays(Path(path), arrays)
        except OSError as error:
            raise UsageError(f"{path}: cannot be written: {error.strerror}") from error

    @staticmethod
    def load(path: str | Path) -> Flow:
        """Read a flow from its file.

        Raises:
            UsageError: The file is missing, or not a flow.
        """
        try:
            return _from_arrays(parse_arrays(read_regular(path)))
        except OSError as error:
            raise UsageError(f"{path}: cannot be read: {error.strerror or error}") from error
        except _DAMAGED as error:
            hint = "make one with `avrare flow fit SAMPLES --out DIR`"
            # NumPy's own message would be about pickles.
            reason = error if zipfile.is_zipfile(path) else "not an .npz file"
            raise UsageError(f"{path}: not a flow ({reason})", hint) from error


def _from_arrays(arrays: dict[str, NDArray[np.generic]]) -> Flow:
    kind = str(arrays["kind"])
    if int(arrays["format"]) != _FORMAT or kind not in KINDS:
        raise ValueError(f"format {arrays['format']}, kind {kind!r}")
    many, samples = int(arrays["blocks"]), int(arrays["samples"])
    numbers = {name.partition(".")[0] for name in arrays if "." in name}
    if len(numbers) != many or samples < 0:
        raise ValueError(f"{many} blocks of which {len(numbers)} are there, fitted to {samples} samples")
    blocks: list[Block] = []
    for i in range(many):
        layers = range(sum(key.startswith(f"{i}.weight") for key in arrays))
        weights = tuple(arrays[f"{i}.weight{j}"].astype(np.float64) for j in layers)
        biases = tuple(arrays[f"{i}.bias{j}"].astype(np.float64) for j in layers)
        network = Network(weights, biases)
        blocks.append(
            AffineCoupling(network)
            if kind == "affine_coupling"
            else SplineAutoregressive(network, float(arrays[f"{i}.bound"]))
        )
    shift, scale = (arrays[name].astype(np.float64) for name in ("shift", "scale"))
    if shift.ndim != 1 or shift.shape != scale.shape or not (scale > 0.0).all():
        raise ValueError("shift and scale do not fit")
    flow = Flow(kind, tuple(blocks), shift, scale, samples)
    _check(flow)
    return flow


def _check(flow: Flow) -> None:
    """Refuse blocks of another size, which may pass by broadcasting, and numbers that are not finite."""
    size = flow.noise_size
    for block in flow.blocks:
        if isinstance(block, AffineCoupling) and len(block.network.biases[-1]) != 2 * (size - size // 2):
            raise ValueError(f"a block is not made for {size} numbers a row")
        if isinstance(block, SplineAutoregressive) and not 0.0 < block.bound < np.inf:
            raise ValueError(f"a spline ends at {block.bound:g}")
    x, log_det = flow.warp(np.zeros((1, size)))
    if x.shape != (1, size) or not np.isfinite(x).all() or not np.isfinite(log_det).all():
        raise ValueError("its arrays do not fit each other, or are not finite")
