"""Rewriting of a scenario with another value of a parameter of its linear system."""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy
from typing import Any

import numpy as np

from avrare.base.errors import UsageError
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
"""Parameter -> attribute of ``LinearSystem`` with its value, or with a factor of its covariance."""


def has_parameter(system: LinearSystem, parameter: str) -> bool:
    """Check whether a system has the parameter; a gain without inputs is empty."""
    value = getattr(system, ATTRIBUTES[parameter])
    return value is not None and value.size > 0


def rewrite_scenario(resolved: dict[str, Any], parameter: str, value: Floats) -> dict[str, Any]:
    """Return a copy of a resolved scenario with another value of one parameter.

    If the parameter affects the Kalman gain, the present gain is written out, so that only the parameter
    changes.

    Args:
        resolved: Scenario as plain data, with the simulator ``linear``.
        parameter: One of ``ATTRIBUTES``.
        value: Value as in ``LinearSystem``: a stack with a leading axis of steps, factors for covariances.

    Raises:
        UsageError: The scenario has another simulator.
    """
    scenario = deepcopy(resolved)
    simulator = scenario["simulator"]
    if simulator["plugin"] != "linear":
        raise UsageError("the system is not linear", "use `simulator: {plugin: linear, ...}`")
    kalman_inputs = ("covariance", "process_noise", "measurement_noise")
    if parameter in kalman_inputs and simulator.get("observer") is not None:
        options = {key: option for key, option in simulator.items() if key != "plugin"}
        observer = from_config(LinearConfig.model_validate(options)).observer
        if observer is not None:
            _set(simulator, "observer", observer)
    _set(simulator, parameter, value)
    return scenario


def _plain(value: Floats) -> list[object]:
    digits = 9
    # Rounded entry by entry: symmetric matrices stay symmetric.
    rounded: list[object] = np.vectorize(lambda entry: float(f"{entry:.{digits}g}"))(value).tolist()
    return rounded


def _covariances(factor: Floats) -> list[object]:
    # einsum keeps the product symmetric to the last digit.
    return _plain(np.asarray(np.einsum("sij,skj->sik", factor, factor)))


def _gain(value: Floats) -> dict[str, object]:
    return {"gain": _plain(value)}


_OPTIONS: dict[str, tuple[str, Callable[[Floats], object]]] = {
    "process_noise": ("process_noise", _covariances),
    "measurement_noise": ("measurement_noise", _covariances),
    "reference": ("reference", _plain),
    "feedforward": ("feedforward", _plain),
    "gain": ("feedback", _gain),
    "observer": ("observer", _gain),
}
"""Parameter -> option of the simulator, and conversion of the value."""


def _set(simulator: dict[str, Any], parameter: str, value: Floats) -> None:
    if parameter == "mean":
        simulator["initial"]["mean"] = _plain(value)[0]
    elif parameter == "covariance":
        simulator["initial"]["covariance"] = _covariances(value)
    else:
        option, convert = _OPTIONS[parameter]
        simulator[option] = convert(value)
