"""avrare: how likely is this driving stack to break this traffic rule?

The public names are loaded when they are first used, so that ``import avrare`` costs next to nothing.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from avrare.api import estimate, load
    from avrare.errors import AvrareError, FormulaError, PluginError, ScenarioError, UsageError
    from avrare.estimation.budget import Budget
    from avrare.estimation.result import Result
    from avrare.logic.api import Formula, stl
    from avrare.rollout.problem import Problem

__version__ = "0.1.0"

_HOMES = {
    "AvrareError": "avrare.errors",
    "Budget": "avrare.estimation.budget",
    "Formula": "avrare.logic.api",
    "FormulaError": "avrare.errors",
    "PluginError": "avrare.errors",
    "Problem": "avrare.rollout.problem",
    "Result": "avrare.estimation.result",
    "ScenarioError": "avrare.errors",
    "UsageError": "avrare.errors",
    "estimate": "avrare.api",
    "load": "avrare.api",
    "stl": "avrare.logic.api",
}

__all__ = [
    "AvrareError",
    "Budget",
    "Formula",
    "FormulaError",
    "PluginError",
    "Problem",
    "Result",
    "ScenarioError",
    "UsageError",
    "__version__",
    "estimate",
    "load",
    "stl",
]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'avrare' has no attribute {name!r}")
    value = getattr(importlib.import_module(_HOMES[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
