"""Model files: fitted perception error models as NumPy arrays and strings, never pickles."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from avrare.base.errors import UsageError, did_you_mean
from avrare.base.stored_files import parse_arrays, read_regular, write_arrays
from avrare.protocols import Floats
from avrare_gp_pem.config import MOST_GHOST_SLOTS
from avrare_gp_pem.runtime.features import COLUMNS, NAMES, Box
from avrare_gp_pem.runtime.gp import DiagonalGp, GpPair, NormalErrorGps, SparseGp
from avrare_gp_pem.runtime.networks import Networks, networks
from avrare_gp_pem.runtime.variant import (
    FittedPem,
    MeasuredGhosts,
    MeasuredPersistence,
    Variant,
    YawErrors,
)

Arrays = Mapping[str, NDArray[Any]]
FORMAT = 3
FOLDER = Path(__file__).parents[1] / "models"
_GP_ARRAYS = ("inducing", "lengthscale", "variance", "location", "factor", "prior", "jitter")
_NUMBERS = ("input_mean", "input_sd", "base_scale", "dof", "limit")
_CALIBRATION = ("bounds", "line", "stretch")
_TAILS = ("near", "tail")  # since format 3
_YAW_ARRAYS = ("flip", "scale", "dof")
_MEMBER = "member_"
"""Begin of the names of a bootstrap refit's arrays; versions that know no ensembles leave them out."""
_PERSISTENCE = ("detection", "position")
_CAR = Box(*(np.array([[value]]) for value in (2.0, 20.0, 1.5, 4.5, 1.8, 1.6, 4.0)))
_UNREADABLE = (
    ValueError,
    OSError,
    EOFError,
    zipfile.BadZipFile,
    np.linalg.LinAlgError,
    IndexError,
    TypeError,
)


def locate(model: str) -> Path:
    """Return the file of a shipped model's name, or of a path that ends in ``.npz``.

    Raises:
        UsageError: The model or file does not exist.
    """
    if model.endswith(".npz"):
        path = Path(model)
        if not path.is_file():
            raise UsageError(f"{model}: no such file")
        return path
    shipped = {path.stem: path for path in FOLDER.glob("*.npz")}
    if model not in shipped:
        hint = did_you_mean(model, shipped) or "give the name of a shipped model or the path of an .npz file"
        raise UsageError(f"unknown perception model {model!r}", hint)
    return shipped[model]


def load(path: Path) -> FittedPem:
    """Read a fitted model of format 1, 2 or 3.

    Raises:
        UsageError: The file was not written by ``save``.
    """
    try:
        arrays = parse_arrays(read_regular(path))
        version = int(arrays["format"])
        if version not in (1, 2, FORMAT):
            raise UsageError(f"{path}: model format {version}, this version reads 1 to {FORMAT}")
        return _from_format_1(arrays) if version == 1 else _from_format_3(arrays)
    except KeyError as error:
        raise UsageError(f"{path}: not a perception model: {error.args[0]!r} is missing") from None
    except _UNREADABLE as error:
        reason = error if zipfile.is_zipfile(path) else "not an .npz file"  # NumPy's message is about pickles
        raise UsageError(f"{path}: not a perception model: {reason}") from None


def save(path: Path, model: FittedPem) -> None:
    """Write a fitted model; the same model gives the same bytes."""
    arrays = {"format": np.array(FORMAT)} | _model_arrays(model)
    for number, member in enumerate(model.ensemble, start=1):
        arrays |= {f"{_MEMBER}{number}_{key}": value for key, value in _model_arrays(member).items()}
    arrays["provenance_keys"] = np.array(list(model.provenance), dtype=np.str_)
    arrays["provenance_values"] = np.array(list(model.provenance.values()), dtype=np.str_)
    write_arrays(path, arrays)


def _model_arrays(model: FittedPem) -> dict[str, NDArray[np.generic]]:
    arrays: dict[str, NDArray[np.generic]] = {}
    for name, variant in (("clean", model.clean), ("delivered", model.delivered)):
        if variant is not None:
            arrays |= {f"{name}_{key}": value for key, value in _variant_arrays(variant).items()}
    if model.yaw is not None:
        arrays |= {f"yaw_{name}": getattr(model.yaw, name) for name in _YAW_ARRAYS}
    if model.persistence is not None:
        arrays |= {f"persistence_{name}": getattr(model.persistence, name) for name in _PERSISTENCE}
    if model.ghosts is not None:
        arrays |= {f"ghosts_{name}": np.asarray(value) for name, value in vars(model.ghosts).items()}
    return arrays


def _variant_arrays(variant: Variant) -> dict[str, NDArray[np.generic]]:
    arrays = {name: np.asarray(getattr(variant, name)) for name in (*_NUMBERS, *_CALIBRATION, *_TAILS)}
    arrays["inputs"] = np.array(variant.inputs, dtype=np.str_)
    arrays |= {name: np.array(getattr(variant, name)) for name in ("link", "frame")}
    latents = variant.latents
    if isinstance(latents, GpPair | NormalErrorGps):
        for prefix, process in (("detection", latents.detection), ("error", latents.error)):
            arrays |= {f"{prefix}_{name}": getattr(process, name) for name in _GP_ARRAYS}
        if isinstance(latents, NormalErrorGps):
            arrays["log_noise"] = latents.log_noise
    elif isinstance(latents, Networks):
        for i, (weight, bias) in enumerate(zip(latents.weights, latents.biases, strict=True)):
            arrays |= {f"weight_{i}": weight, f"bias_{i}": bias}
    else:
        raise TypeError(f"{type(latents).__name__} cannot be stored in a file")
    return arrays


def _from_format_3(arrays: Arrays) -> FittedPem:
    model = _model(arrays, _provenance(arrays))
    members: list[FittedPem] = []
    while f"{_MEMBER}{len(members) + 1}_clean_link" in arrays:
        prefix = f"{_MEMBER}{len(members) + 1}_"
        member_arrays = {
            key.removeprefix(prefix): value for key, value in arrays.items() if key.startswith(prefix)
        }
        members.append(_model(member_arrays, model.provenance))
    return replace(model, ensemble=tuple(members))


def _model(arrays: Arrays, provenance: Mapping[str, str]) -> FittedPem:
    parts: dict[str, Variant] = {}
    for name in ("clean", "delivered"):
        variant_arrays = {
            key[len(name) + 1 :]: value for key, value in arrays.items() if key.startswith(f"{name}_")
        }
        if variant_arrays:
            parts[name] = _variant(variant_arrays)
    yaw = (
        _yaw(*(np.asarray(arrays[f"yaw_{name}"], float) for name in _YAW_ARRAYS))
        if "yaw_flip" in arrays
        else None
    )
    lasting = None
    if "persistence_detection" in arrays:
        lasting = MeasuredPersistence(*(_pair(arrays[f"persistence_{name}"]) for name in _PERSISTENCE))
    ghosts = _ghosts(arrays) if "ghosts_rate" in arrays else None
    return FittedPem(parts["clean"], parts.get("delivered"), provenance, yaw, lasting, ghosts)


def _yaw(flip: Floats, scale: Floats, dof: Floats) -> YawErrors:
    if flip.shape != (2,) or scale.shape != (2,) or dof.shape != () or not np.isfinite([*flip, *scale]).all():
        raise ValueError("its yaw errors are not two pairs of numbers and a number")
    if not (scale[0] > 0 and scale[1] >= 0 and _is_tabulated(dof)):
        raise ValueError("its yaw errors have no positive scale, or degrees of freedom not from 1 to 30")
    return YawErrors(flip, scale, dof)


def _ghosts(arrays: Arrays) -> MeasuredGhosts:
    rate, seconds, width = (float(arrays[f"ghosts_{name}"]) for name in ("rate", "persistence", "width"))
    points = np.asarray(arrays["ghosts_points"], float).reshape(-1, 2)
    numbers = np.append(points.reshape(-1), (rate, seconds, width))
    if not len(points) or not np.isfinite(numbers).all() or min(seconds, width) < 0:
        raise ValueError("its false detections have no rate, time and places")
    if not 0 < rate <= MOST_GHOST_SLOTS / 2:
        raise ValueError(f"it has {rate:g} false detections in a frame")
    return MeasuredGhosts(rate, seconds, points, width)


def _pair(values: NDArray[np.generic]) -> Floats:
    seconds, share = np.asarray(values, float)
    if not (0 <= seconds < np.inf and 0 <= share <= 1):
        raise ValueError("its persistence is not a time constant and a share")
    return np.array([seconds, share])


def _from_format_1(arrays: Arrays) -> FittedPem:  # two processes, ten inputs, no artefact or calibration
    numbers = {name: np.asarray(arrays[name], float) for name in _NUMBERS}
    variant = Variant(_gp_pair(arrays), NAMES, link="probit", frame="vehicle", **numbers)
    return FittedPem(_check(variant), None, _provenance(arrays))


def _variant(arrays: Arrays) -> Variant:
    names = tuple(str(name) for name in arrays["inputs"])
    unknown = set(names) - set(COLUMNS)
    if unknown:
        raise ValueError(
            f"it reads the columns {', '.join(sorted(unknown))}, which this version does not know"
        )
    link, frame = str(arrays["link"]), str(arrays["frame"])
    if link not in ("probit", "logit") or frame not in ("vehicle", "ego"):
        raise ValueError(f"its link is {link[:40]!r}, its frame {frame[:40]!r}")
    variant = Variant(
        latents=_gp_pair(arrays) if "detection_inducing" in arrays else _networks(arrays),
        inputs=names,
        link=link,
        frame=frame,
        **{name: np.asarray(arrays[name], float) for name in (*_NUMBERS, *_CALIBRATION)},
        **{name: np.asarray(arrays[name], float) for name in _TAILS if name in arrays},  # format 2 has none
    )
    return _check(variant)


def _check(variant: Variant) -> Variant:
    law = variant.law(_CAR, speed_sd=0.0)
    parts = (law.detect, law.location, law.scale, law.limit, law.dof, 1.0 if law.power is None else law.power)
    unbounded = np.isinf(law.dof).all() and np.isinf(law.limit)  # normal errors
    if not all(np.isfinite(part).all() for part in (parts[:3] if unbounded else parts)):
        raise ValueError("its predictions are not finite")
    if not (_is_tabulated(law.dof) and np.min(law.scale) > 0.0 and np.min(law.limit) > 0.0):
        raise ValueError("its scales or limit are not positive, or its degrees of freedom not from 1 to 30")
    return variant


def _is_tabulated(dof: ArrayLike) -> bool:
    numbers = np.asarray(dof, float)
    return bool(np.all((numbers >= 1.0) & (numbers <= 30.0) | (numbers == np.inf)))


def _networks(arrays: Arrays) -> Networks:
    layers = range(sum(key.startswith("weight_") for key in arrays))
    weights = tuple(np.asarray(arrays[f"weight_{i}"], float) for i in layers)
    return networks(weights, tuple(np.asarray(arrays[f"bias_{i}"], float) for i in layers))


def _gp_pair(arrays: Arrays) -> GpPair | NormalErrorGps:
    processes = []
    for prefix in ("detection", "error"):
        parameters = {name: np.asarray(arrays[f"{prefix}_{name}"], float) for name in _GP_ARRAYS}
        kind = DiagonalGp if parameters["factor"].ndim == 2 else SparseGp
        processes.append(kind(**parameters))
    detection, error = processes
    if "log_noise" in arrays:
        return NormalErrorGps(detection, error, np.asarray(arrays["log_noise"], float).reshape(2))
    return GpPair(detection, error)


def _provenance(arrays: Arrays) -> dict[str, str]:
    keys, values = arrays["provenance_keys"], arrays["provenance_values"]
    return {str(key): str(value) for key, value in zip(keys, values, strict=True)}
