"""avrare: how likely is this driving stack to break this traffic rule?

The public names are imported when they are first used, so that ``import avrare`` is fast.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

import avrare.base.renderers as _table
import avrare.report.renderers as _renderers

if TYPE_CHECKING:
    from avrare.analysis.causes.require import require as require
    from avrare.analysis.causes.scenario_parameters import sensitivity as sensitivity
    from avrare.base.errors import AvrareError as AvrareError
    from avrare.base.errors import FormulaError as FormulaError
    from avrare.base.errors import HealthWarning as HealthWarning
    from avrare.base.errors import PluginError as PluginError
    from avrare.base.errors import ScenarioError as ScenarioError
    from avrare.base.errors import UsageError as UsageError
    from avrare.base.version import __version__ as __version__
    from avrare.estimation.budget import Budget as Budget
    from avrare.estimation.estimate_problem import estimate as estimate
    from avrare.estimation.estimate_problem import estimate_all as estimate_all
    from avrare.estimation.result import Result as Result
    from avrare.estimation.result import Results as Results
    from avrare.logic.formula import Formula as Formula
    from avrare.logic.formula import stl as stl
    from avrare.report.session.scenario_run import run as run
    from avrare.rollout.loaded_scenario import load as load
    from avrare.rollout.problem import Problem as Problem

_MODULES = {
    "avrare.analysis.causes.require": "require",
    "avrare.analysis.causes.scenario_parameters": "sensitivity",
    "avrare.base.errors": "AvrareError FormulaError HealthWarning PluginError ScenarioError UsageError",
    "avrare.base.version": "__version__",
    "avrare.estimation.budget": "Budget",
    "avrare.estimation.estimate_problem": "estimate estimate_all",
    "avrare.estimation.result": "Result Results",
    "avrare.report.session.scenario_run": "run",
    "avrare.logic.formula": "Formula stl",
    "avrare.rollout.loaded_scenario": "load",
    "avrare.rollout.problem": "Problem",
}
_HOMES = {name: module for module, names in _MODULES.items() for name in names.split()}
__all__ = sorted(_HOMES)
_table.fill(_renderers.RENDERERS)


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'avrare' has no attribute {name!r}")
    value = getattr(importlib.import_module(_HOMES[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
