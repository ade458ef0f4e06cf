"""A scenario with another value of one of its linear system's parameters."""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy
from typing import Any

import numpy as np

from avrare.errors import UsageError
from avrare.protocols import Floats
from avrare_linear.config import LinearConfig
from avrare_linear.simulator import from_config
from avrare_linear.system import LinearSystem

ATTRIBUTES = {
    "mean": "mean",
    "covariance": "spread",
    "process_noise": "process",
    "measurement_noise": "measurement",
    "reference": "reference",
    "feedforward": "feedforward",
    "gain": "gain",
    "observer": "observer",
}
"""Parameter -> the attribute of ``LinearSystem`` that holds it, or a factor of it."""
_DIGITS = 9
_MOVE_KALMAN = ("covariance", "process_noise", "measurement_noise")


def has(system: LinearSystem, parameter: str) -> bool:
    """Whether a system has something to be changed there: a gain without inputs is empty."""
    value = getattr(system, ATTRIBUTES[parameter])
    return value is not None and value.size > 0


def rewritten(resolved: dict[str, Any], parameter: str, value: Floats) -> dict[str, Any]:
    """A copy of a resolved scenario with another parameter, and that only.

    A Kalman gain is written out where it would follow the noise: the system of ``value`` has the old one.

    Args:
        resolved: Plain data; its simulator is ``linear``.
        parameter: One of ``ATTRIBUTES``.
        value: As ``LinearSystem`` has it: a stack with a leading axis of steps, factors for covariances.

    Raises:
        UsageError: The simulator is another one.
    """
    scenario = deepcopy(resolved)
    simulator = scenario["simulator"]
    if simulator["plugin"] != "linear":
        raise UsageError("the system is not linear", "use `simulator: {plugin: linear, ...}`")
    if parameter in _MOVE_KALMAN and simulator.get("observer") is not None:
        options = {key: option for key, option in simulator.items() if key != "plugin"}
        observer = from_config(LinearConfig.model_validate(options)).observer
        if observer is not None:
            _WRITERS["observer"](simulator, observer)
    _WRITERS[parameter](simulator, value)
    return scenario


def _mean(simulator: dict[str, Any], value: Floats) -> None:
    simulator["initial"]["mean"] = _plain(value)[0]


def _covariance(simulator: dict[str, Any], value: Floats) -> None:
    simulator["initial"]["covariance"] = _plain(_squared(value))


def _noise(name: str) -> Callable[[dict[str, Any], Floats], None]:
    def write(simulator: dict[str, Any], value: Floats) -> None:
        simulator[name] = _plain(_squared(value))

    return write


def _rows(name: str) -> Callable[[dict[str, Any], Floats], None]:
    def write(simulator: dict[str, Any], value: Floats) -> None:
        simulator[name] = _plain(value)

    return write


def _gain(name: str) -> Callable[[dict[str, Any], Floats], None]:
    def write(simulator: dict[str, Any], value: Floats) -> None:
        simulator[name] = {"gain": _plain(value)}

    return write


_WRITERS: dict[str, Callable[[dict[str, Any], Floats], None]] = {
    "mean": _mean,
    "covariance": _covariance,
    "process_noise": _noise("process_noise"),
    "measurement_noise": _noise("measurement_noise"),
    "reference": _rows("reference"),
    "feedforward": _rows("feedforward"),
    "gain": _gain("feedback"),
    "observer": _gain("observer"),
}


def _squared(factor: Floats) -> Floats:
    """Covariances (S, n, n) of their factors, symmetric to the last digit that is written."""
    return np.asarray(np.einsum("sij,skj->sik", factor, factor))


def _plain(value: Floats) -> list[Any]:
    """Lists of numbers with as many digits as anybody needs; symmetric stays symmetric."""
    rounded: list[Any] = np.vectorize(lambda entry: float(f"{entry:.{_DIGITS}g}"))(value).tolist()
    return rounded
