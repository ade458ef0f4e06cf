"""avrare: how likely is this driving stack to break this traffic rule?

The public names are imported when they are first used, so that ``import avrare`` is fast.
"""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING

import avrare.base.renderers as _table
import avrare.output.renderers as _renderers

if TYPE_CHECKING:  # the only list of the public names: ``find_modules`` reads it, too
    from avrare.analysis.causes.require import require as require
    from avrare.analysis.causes.scenario_parameters import sensitivity as sensitivity
    from avrare.analysis.causes.synthesis import synthesize as synthesize
    from avrare.analysis.causes.why import why as why
    from avrare.analysis.check.check import check as check
    from avrare.analysis.check.validation import validate as validate
    from avrare.analysis.compare.paired_comparison import compare_versions as compare_versions
    from avrare.analysis.compare.study import compare as compare
    from avrare.analysis.failures.falsify import falsify as falsify
    from avrare.analysis.failures.stored_replays import replay as replay
    from avrare.analysis.monitor.batch import monitor_all as monitor_all
    from avrare.analysis.monitor.drive import monitor as monitor
    from avrare.analysis.rates.rate import rate as rate
    from avrare.base.errors import AvrareError as AvrareError
    from avrare.base.errors import FormulaError as FormulaError
    from avrare.base.errors import HealthWarning as HealthWarning
    from avrare.base.errors import PluginError as PluginError
    from avrare.base.errors import ScenarioError as ScenarioError
    from avrare.base.errors import UsageError as UsageError
    from avrare.base.version import __version__ as __version__
    from avrare.estimation.estimate_problem import estimate as estimate
    from avrare.estimation.estimate_problem import estimate_all as estimate_all
    from avrare.estimation.plan.budget import Budget as Budget
    from avrare.estimation.result.result import Result as Result
    from avrare.estimation.result.result import Results as Results
    from avrare.logic.formula import Formula as Formula
    from avrare.logic.formula import stl as stl
    from avrare.output.renderers import plot as plot
    from avrare.output.renderers import report as report
    from avrare.output.session.scenario_run import run as run
    from avrare.output.session.trace import trace as trace
    from avrare.results.run import Run as Run
    from avrare.rollout.loaded_scenario import load as load
    from avrare.rollout.problem import Problem as Problem
    from avrare.rollout.trace import Trace as Trace
else:

    def __getattr__(name: str) -> object:
        import importlib

        modules = find_modules()
        if name == "__all__":
            return sorted(modules)
        if name not in modules:
            raise AttributeError(f"module 'avrare' has no attribute {name!r}")
        value = getattr(importlib.import_module(modules[name]), name)
        globals()[name] = value
        return value


_table.fill(_renderers.RENDERERS)


def __dir__() -> list[str]:
    return sorted(find_modules())


@functools.cache
def find_modules() -> dict[str, str]:
    """Return the module of each public name, read from the imports above."""
    import ast
    from pathlib import Path

    statements = ast.walk(ast.parse(Path(__file__).read_text(encoding="utf-8")))
    imports = [one for one in statements if isinstance(one, ast.ImportFrom)]
    return {
        alias.name: statement.module
        for statement in imports
        if statement.module is not None and statement.module.startswith("avrare.")
        for alias in statement.names
    }
