"""The file of a fitted model: NumPy arrays and strings, never pickles."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from avrare.errors import UsageError, did_you_mean
from avrare_gp_pem.diagonal_gp import DiagonalGp, GpPair, diagonal_gp
from avrare_gp_pem.features import COLUMNS, NAMES, Box
from avrare_gp_pem.gp import SparseGp, sparse_gp
from avrare_gp_pem.networks import Networks, networks
from avrare_gp_pem.variant import Variant
from avrare_gp_pem.yaw import YawLaw

Arrays = dict[str, NDArray[Any]]
FORMAT = 2
FOLDER = Path(__file__).parent / "models"
_GP_ARRAYS = ("inducing", "lengthscale", "variance", "location", "factor", "prior", "jitter")
_NUMBERS = ("input_mean", "input_sd", "base_scale", "dof", "limit", "bounds", "line", "stretch")
_YAW_ARRAYS = ("flip", "scale", "dof")
_CAR = Box(*(np.array([[value]]) for value in (2.0, 20.0, 1.5, 4.5, 1.8, 1.6, 4.0)))
_NO_MODEL = (ValueError, OSError, EOFError, zipfile.BadZipFile, np.linalg.LinAlgError, IndexError, TypeError)


@dataclass(frozen=True)
class FittedPem:
    """A fitted perception error model.

    Attributes:
        clean: The detector, free of what the matching of labels added; what a simulation should use.
        delivered: The labels as they are, artefact included; None where the file has no such part.
        provenance: Where it comes from and under which licence, by keyword.
        yaw: Errors of yaw; None where the data had none.
    """

    clean: Variant
    delivered: Variant | None
    provenance: Mapping[str, str]
    yaw: YawLaw | None = None


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
    """Read a fitted model, of this format or the first one.

    Raises:
        UsageError: The file is not one that ``save`` wrote.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays: Arrays = {name: file[name] for name in file.files}
        version = int(arrays["format"])
        if version not in (1, FORMAT):
            raise UsageError(f"{path}: model format {version}, this version reads 1 and {FORMAT}")
        return _first_format(arrays) if version == 1 else _assemble(arrays)
    except KeyError as error:
        raise UsageError(f"{path}: no perception model: {error.args[0]!r} is missing") from None
    except _NO_MODEL as error:
        reason = error if zipfile.is_zipfile(path) else "not an .npz file"  # NumPy talks of pickles there
        raise UsageError(f"{path}: no perception model: {reason}") from None


def save(path: Path, model: FittedPem) -> None:
    """Write a fitted model; the same model gives the same bytes."""
    arrays: Arrays = {"format": np.array(FORMAT)}
    for name in ("clean", "delivered"):
        variant = getattr(model, name)
        if variant is not None:
            arrays |= {f"{name}_{key}": value for key, value in _variant_arrays(variant).items()}
    if model.yaw is not None:
        arrays |= {f"yaw_{name}": getattr(model.yaw, name) for name in _YAW_ARRAYS}
    arrays["provenance_keys"] = np.array(list(model.provenance), dtype=np.str_)
    arrays["provenance_values"] = np.array(list(model.provenance.values()), dtype=np.str_)
    np.savez_compressed(path, allow_pickle=False, **arrays)


def _variant_arrays(variant: Variant) -> Arrays:
    arrays: Arrays = {name: np.asarray(getattr(variant, name)) for name in _NUMBERS}
    arrays["inputs"] = np.array(variant.inputs, dtype=np.str_)
    arrays |= {name: np.array(getattr(variant, name)) for name in ("link", "frame")}
    if isinstance(variant.latents, GpPair):
        return arrays | _gp_arrays(variant.latents)
    if isinstance(variant.latents, Networks):
        for i, (weight, bias) in enumerate(zip(variant.latents.weights, variant.latents.biases, strict=True)):
            arrays |= {f"weight_{i}": weight, f"bias_{i}": bias}
        return arrays
    raise TypeError(f"{type(variant.latents).__name__} has no form in a file")


def _gp_arrays(pair: GpPair) -> Arrays:
    return {
        f"{prefix}_{name}": getattr(getattr(pair, prefix), name)
        for prefix in ("detection", "error")
        for name in _GP_ARRAYS
    }


def _assemble(arrays: Mapping[str, NDArray[Any]]) -> FittedPem:
    parts: dict[str, Variant | None] = {"clean": None, "delivered": None}
    for name in parts:
        own = {key[len(name) + 1 :]: value for key, value in arrays.items() if key.startswith(f"{name}_")}
        parts[name] = _variant(own) if own else None
    if parts["clean"] is None:
        raise KeyError("clean")
    yaw = YawLaw(*(arrays[f"yaw_{name}"] for name in _YAW_ARRAYS)) if "yaw_flip" in arrays else None
    return FittedPem(parts["clean"], parts["delivered"], _provenance(arrays), yaw)


def _variant(arrays: Arrays) -> Variant:
    names = tuple(str(name) for name in arrays["inputs"])
    unknown = set(names) - set(COLUMNS)
    if unknown:
        raise ValueError(f"it reads {', '.join(sorted(unknown))}, which this version does not know")
    variant = Variant(
        latents=_gp_pair(arrays) if "detection_inducing" in arrays else _networks(arrays),
        inputs=names,
        link=str(arrays["link"]),
        frame=str(arrays["frame"]),
        **{name: np.asarray(arrays[name], float) for name in _NUMBERS},
    )
    law = variant.law(_CAR, speed_sd=0.0)  # a file whose parts do not fit each other is refused here
    if not all(np.isfinite(part).all() for part in (law.detect, law.location, law.scale, law.limit, law.dof)):
        raise ValueError("it does not give finite numbers")
    return variant


def _networks(arrays: Arrays) -> Networks:
    layers = range(sum(key.startswith("weight_") for key in arrays))
    weights = tuple(np.asarray(arrays[f"weight_{i}"], float) for i in layers)
    return networks(weights, tuple(np.asarray(arrays[f"bias_{i}"], float) for i in layers))


def _gp_pair(arrays: Mapping[str, NDArray[Any]]) -> GpPair:
    detection, error = (
        _process({name: np.asarray(arrays[f"{prefix}_{name}"], float) for name in _GP_ARRAYS})
        for prefix in ("detection", "error")
    )
    return GpPair(detection, error)


def _process(parameters: dict[str, NDArray[np.float64]]) -> SparseGp | DiagonalGp:
    return (diagonal_gp if parameters["factor"].ndim == 2 else sparse_gp)(**parameters)


def _first_format(arrays: Arrays) -> FittedPem:
    """A file of two processes and ten inputs, without an artefact or a calibration."""
    plain = ("input_mean", "input_sd", "base_scale", "dof", "limit")
    variant = Variant(
        latents=_gp_pair(arrays),
        inputs=NAMES,
        link="probit",
        frame="vehicle",
        **{name: np.asarray(arrays[name], float) for name in plain},
    )
    return FittedPem(variant, None, _provenance(arrays))


def _provenance(arrays: Mapping[str, NDArray[Any]]) -> dict[str, str]:
    keys, values = arrays["provenance_keys"], arrays["provenance_values"]
    return {str(key): str(value) for key, value in zip(keys, values, strict=True)}
