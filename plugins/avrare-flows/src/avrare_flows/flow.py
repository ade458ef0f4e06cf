"""A fitted flow: physical noise from standard normal numbers, with the density that it really has."""

from __future__ import annotations

import zipfile
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from avrare.errors import UsageError
from avrare.protocols import Floats
from avrare_flows.blocks import AffineCoupling, Block, Network, SplineAutoregressive, Warped

KINDS = ("affine_coupling", "spline_autoregressive")
_FORMAT = 1
_DAMAGED = (
    ValueError, LookupError, EOFError, TypeError, AttributeError, ArithmeticError, NotImplementedError,
    RuntimeError, zipfile.BadZipFile, zlib.error,
)  # fmt: skip
"""What reading a file raises that is no flow, or no longer one."""


@dataclass(frozen=True, eq=False)
class Flow:
    """An ``avrare_flows.laws.Law``: blocks one after the other, then shift + scale x.

    Attributes:
        kind: One of ``KINDS``, or how it was made where it was not fitted.
        blocks: From normal to nearly physical numbers.
        shift: (n,).
        scale: (n,) positive.
        samples: How many it was fitted to; 0: to none.
    """

    kind: str
    blocks: tuple[Block, ...]
    shift: Floats
    scale: Floats
    samples: int = 0

    @property
    def noise_size(self) -> int:
        """Numbers of a row."""
        return len(self.shift)

    @property
    def note(self) -> str:
        """What a result should say of it."""
        return (
            f"the noise comes from a flow fitted to {self.samples} samples: how far it is from the real "
            "noise no interval tells; a tenth in the scale can be a factor of ten in the probability"
        )

    def warp(self, z: Floats) -> Warped:
        """Physical rows of standard normal rows (N, n), and log |det dx/dz| (N,)."""
        x, log_det = z, np.zeros(len(z))
        for block in self.blocks:
            x, part = block.push(x)
            log_det = log_det + part
        return np.ascontiguousarray(self.shift + self.scale * x), log_det + float(np.log(self.scale).sum())

    def physical(self, z: Floats) -> Floats:
        """Physical rows of standard normal rows (N, n)."""
        return self.warp(z)[0]

    def save(self, path: str | Path) -> None:
        """Write a file for ``load``: arrays only.

        Raises:
            UsageError: The file cannot be written.
        """
        arrays: dict[str, Any] = {
            "format": _FORMAT, "kind": self.kind, "shift": self.shift, "scale": self.scale,
            "samples": self.samples, "blocks": len(self.blocks),
        }  # fmt: skip
        for i, block in enumerate(self.blocks):
            if not isinstance(block, AffineCoupling | SplineAutoregressive):
                raise UsageError(f"a {type(block).__name__} cannot be written to a file")
            if isinstance(block, SplineAutoregressive):
                arrays[f"{i}.bound"] = block.bound
            network = block.network
            for j, (weight, bias) in enumerate(zip(network.weights, network.biases, strict=True)):
                arrays[f"{i}.weight{j}"], arrays[f"{i}.bias{j}"] = weight, bias
        try:
            with Path(path).open("wb") as file:
                np.savez_compressed(file, **arrays)
        except OSError as error:
            raise UsageError(f"{path}: cannot be written: {error.strerror}") from error

    @staticmethod
    def load(path: str | Path) -> Flow:
        """A flow from its file.

        Raises:
            UsageError: There is no such file, or it holds something else.
        """
        try:
            with np.load(path, allow_pickle=False) as file:
                arrays = dict(file)
            return _of_arrays(arrays)
        except OSError as error:
            raise UsageError(f"{path}: cannot be read: {error.strerror or error}") from error
        except _DAMAGED as error:
            hint = "make one with `avrare flow fit SAMPLES --out flow.npz`"
            reason = error if zipfile.is_zipfile(path) else "not an .npz file"  # NumPy talks of pickles there
            raise UsageError(f"{path}: is no flow ({reason})", hint) from error


def _of_arrays(arrays: dict[str, NDArray[Any]]) -> Flow:
    kind = str(arrays["kind"])
    if int(arrays["format"]) != _FORMAT or kind not in KINDS:
        raise ValueError(f"format {arrays['format']}, kind {kind!r}")
    blocks: list[Block] = []
    for i in range(int(arrays["blocks"])):
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
    flow = Flow(kind, tuple(blocks), shift, scale, int(arrays["samples"]))
    _try(flow)
    return flow


def _try(flow: Flow) -> None:
    """Complains of blocks of another size, which may pass by broadcasting, and of what is not finite."""
    size = flow.noise_size
    for block in flow.blocks:
        if isinstance(block, AffineCoupling) and len(block.network.biases[-1]) != 2 * (size - size // 2):
            raise ValueError(f"a block is not made for {size} numbers a row")
    x, log_det = flow.warp(np.zeros((1, size)))
    if x.shape != (1, size) or not np.isfinite(x).all() or not np.isfinite(log_det).all():
        raise ValueError("its arrays do not fit each other, or are not finite")
