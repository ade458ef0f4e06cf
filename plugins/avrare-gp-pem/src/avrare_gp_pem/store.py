"""The file of a fitted model: NumPy arrays and strings, never pickles."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from avrare.errors import UsageError, did_you_mean
from avrare_gp_pem.gp import SparseGp, sparse_gp

Floats = NDArray[np.float64]
FORMAT = 1
FOLDER = Path(__file__).parent / "models"
_GP_ARRAYS = ("inducing", "lengthscale", "variance", "location", "factor", "prior", "jitter")


@dataclass(frozen=True)
class FittedPem:
    """A fitted perception error model.

    Attributes:
        detection: One latent function f; detection has probability Phi(f).
        error: Four latent functions: standardised location along and across the vehicle, log scale likewise.
        input_mean: (10,) subtracted from the features.
        input_sd: (10,) they are divided by.
        base_scale: (2, 2) rows along and across: what errors are divided by is [0] + [1] x range [m].
        dof: (2,) degrees of freedom of the Student-t errors.
        limit: Errors end this far from their centre [m].
        provenance: Where it comes from and under which licence, by keyword.
    """

    detection: SparseGp
    error: SparseGp
    input_mean: Floats
    input_sd: Floats
    base_scale: Floats
    dof: Floats
    limit: float
    provenance: Mapping[str, str]


def locate(model: str) -> Path:
    """The file of a shipped model's name, or of a path that ends in ``.npz``.

    Raises:
        UsageError: There is no such model or file.
    """
    if model.endswith(".npz"):
        path = Path(model)
        if not path.is_file():
            raise UsageError(f"{model}: no such file")
        return path
    shipped = {path.stem: path for path in FOLDER.glob("*.npz")}
    if model not in shipped:
        hint = did_you_mean(model, shipped) or "give a shipped model's name or the path of an .npz file"
        raise UsageError(f"unknown perception model {model!r}", hint)
    return shipped[model]


def load(path: Path) -> FittedPem:
    """Read a fitted model.

    Raises:
        UsageError: The file is not one that ``save`` wrote.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        if int(arrays["format"]) != FORMAT:
            raise UsageError(f"{path}: model format {arrays['format']}, this version reads {FORMAT}")
        return _assemble(arrays)
    except KeyError as error:
        raise UsageError(f"{path}: no perception model: {error.args[0]!r} is missing") from None
    except (ValueError, OSError, EOFError, zipfile.BadZipFile, np.linalg.LinAlgError) as error:
        raise UsageError(f"{path}: no perception model: {error}") from None


def save(path: Path, model: FittedPem) -> None:
    """Write a fitted model; the same model gives the same bytes."""
    arrays: dict[str, NDArray[np.generic]] = {"format": np.array(FORMAT)}
    for prefix in ("detection", "error"):
        arrays |= {f"{prefix}_{name}": getattr(getattr(model, prefix), name) for name in _GP_ARRAYS}
    arrays |= {name: np.asarray(getattr(model, name)) for name in _OTHER_ARRAYS}
    arrays["provenance_keys"] = np.array(list(model.provenance), dtype=np.str_)
    arrays["provenance_values"] = np.array(list(model.provenance.values()), dtype=np.str_)
    np.savez_compressed(path, allow_pickle=False, **arrays)


_OTHER_ARRAYS = ("input_mean", "input_sd", "base_scale", "dof", "limit")


def _assemble(arrays: Mapping[str, NDArray[np.generic]]) -> FittedPem:
    def process(prefix: str) -> SparseGp:
        return sparse_gp(**{name: np.asarray(arrays[f"{prefix}_{name}"], float) for name in _GP_ARRAYS})

    keys, values = arrays["provenance_keys"], arrays["provenance_values"]
    return FittedPem(
        detection=process("detection"),
        error=process("error"),
        input_mean=np.asarray(arrays["input_mean"], float),
        input_sd=np.asarray(arrays["input_sd"], float),
        base_scale=np.asarray(arrays["base_scale"], float),
        dof=np.asarray(arrays["dof"], float),
        limit=float(np.asarray(arrays["limit"], float)),
        provenance={str(key): str(value) for key, value in zip(keys, values, strict=True)},
    )
