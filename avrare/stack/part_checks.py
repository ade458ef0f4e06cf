"""Checks of what the parts of a stack declare, noise names among it, and of the arrays that they return."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from avrare.base.errors import UsageError
from avrare.driving import Scene
from avrare.protocols import Bools, Floats, PerceptionErrorModel, Signals, Simulator, System

NoisyPart = System | Simulator | PerceptionErrorModel


def find_noise_names(part: NoisyPart, label: str = "noise") -> tuple[str, ...]:
    """Return the names of a part's noise numbers: those it declares, else ``label`` and a number.

    Raises:
        UsageError: It declares more or fewer names than numbers.
    """
    own_names = part.noise_names
    if own_names is None:
        return tuple(f"{label} {channel}" for channel in range(part.noise_size))
    if isinstance(own_names, str) or not isinstance(own_names, Iterable):
        text = f"{type(part).__name__} has noise_names {own_names!r}, which is not a list of names"
        raise UsageError(text, "give one name for each noise number, or leave noise_names out")
    names = tuple(map(str, own_names))
    if len(names) != part.noise_size:
        raise UsageError(
            f"{type(part).__name__} has {len(names)} noise_names, but noise_size is {part.noise_size}",
            "give one name for each noise number, or leave noise_names out",
        )
    return names


def find_perfect_noise(part: NoisyPart) -> NDArray[np.float64]:
    """Return the noise numbers (noise_size,) of a part that makes no errors: zeros unless it says otherwise.

    Zero is the median of every channel. A detection needs another number: at its median, a vehicle that is
    detected less than half of the time is missed.
    """
    if part.perfect_noise is None:
        return np.zeros(part.noise_size)
    name, hint = type(part).__name__, "give one number for each noise number, or leave perfect_noise out"
    try:
        numbers = np.asarray(part.perfect_noise, dtype=np.float64)
    except (TypeError, ValueError):
        text = f"{name} has perfect_noise {part.perfect_noise!r}, which are not numbers"
        raise UsageError(text, hint) from None
    if numbers.shape != (part.noise_size,):
        size = f"{numbers.size}" if numbers.ndim == 1 else f"an array {numbers.shape} of"
        text = f"{name} has {size} perfect_noise, but noise_size is {part.noise_size}"
        raise UsageError(text, hint)
    return numbers


def check_declarations(part: NoisyPart) -> None:
    """Raise the ``UsageError`` of a part whose noise names, perfect noise or warnings do not fit."""
    find_noise_names(part)
    find_perfect_noise(part)
    _check_texts(part, "warnings", part.warnings, '{"coarse_grid": "the grid is coarse"}')


def check_dynamics(part: System | Simulator) -> None:
    """Raise a ``UsageError`` if declarations, lacks or scene of a system or simulator are invalid."""
    check_declarations(part)
    if part.lacks is not None:
        _check_texts(part, "lacks", part.lacks, '{"branches": "its states cannot be copied"}')
    if part.scene is not None and not isinstance(part.scene, Scene):
        text = f"{type(part).__name__} has scene {part.scene!r}, which is not a Scene"
        raise UsageError(text, "give an avrare.driving.Scene, or leave scene out")


def _check_texts(part: NoisyPart, name: str, texts: object, example: str) -> None:
    if not isinstance(texts, Mapping) or not all(isinstance(text, str) for text in (*texts, *texts.values())):
        text = f"{type(part).__name__} has {name} {texts!r}, which are not texts by name"
        raise UsageError(text, f"give a dict such as {example}, or leave {name} out")


def check_signals(signals: Signals, n: int) -> Signals:
    """Return signals by name, each an array (n, ...).

    Raises:
        UsageError: They are not a mapping, or one has another shape.
    """
    if not isinstance(signals, Mapping):
        raise UsageError(
            f"signals(state) returned {type(signals).__name__}, not a mapping from names to arrays",
            'return a dict such as {"x": state.x}',
        )
    return {name: check_rows(f"signal {name!r}", values, n) for name, values in signals.items()}


def check_rows(what: str, values: object, n: int) -> NDArray[Any]:
    """Return ``values``, an array (n, ...); a ``UsageError`` names ``what`` has another shape."""
    if not isinstance(values, np.ndarray) or values.ndim == 0 or values.shape[0] != n:
        shape = values.shape if isinstance(values, np.ndarray | np.generic) else type(values).__name__
        raise UsageError(
            f"{what} has shape {shape}, but a batch of {n} particles needs ({n},) or ({n}, ...)",
            "return NumPy arrays with one entry a particle",
        )
    return values


def find_nan(values: Floats) -> Bools:
    """Return the rows (N,) with a number that is NaN."""
    if values.dtype.kind != "f":
        return np.zeros(len(values), dtype=bool)
    return np.asarray(np.isnan(values).reshape(len(values), -1).any(axis=1))
