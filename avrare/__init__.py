"""avrare: how likely is this driving stack to break this traffic rule?

The public names are imported when they are first used, so that ``import avrare`` is fast.
"""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING

import avrare.base.renderers as _table
import avrare.output.renderers as _renderers

if TYPE_CHECKING:  # the public names of the core: ``find_modules`` reads them, too
    from avrare.analysis.causes.why import why as why
    from avrare.analysis.check.check import check as check
    from avrare.analysis.check.validation import validate as validate
    from avrare.analysis.compare.paired_comparison import compare_versions as compare_versions
    from avrare.analysis.compare.study import compare as compare
    from avrare.analysis.failures.falsify import falsify as falsify
    from avrare.analysis.failures.stored_replays import replay as replay
    from avrare.analysis.rates.rate import rate as rate
    from avrare.base.errors import AvrareError as AvrareError
    from avrare.base.errors import FormulaError as FormulaError
    from avrare.base.errors import HealthWarning as HealthWarning
    from avrare.base.errors import PluginError as PluginError
    from avrare.base.errors import ScenarioError as ScenarioError
    from avrare.base.errors import UsageError as UsageError
    from avrare.base.version import __version__ as __version__
    from avrare.estimation.estimate import estimate as estimate
    from avrare.estimation.estimate import estimate_all as estimate_all
    from avrare.estimation.plan.budget import Budget as Budget
    from avrare.estimation.result.result import Result as Result
    from avrare.estimation.result.result import Results as Results
    from avrare.logic.formula import Formula as Formula
    from avrare.logic.formula import stl as stl
    from avrare.output.renderers import plot as plot
    from avrare.output.renderers import report as report
    from avrare.output.scenario_run import run as run
    from avrare.output.trace import trace as trace
    from avrare.results.run import Run as Run
    from avrare.rollout.loaded_scenario import load as load
    from avrare.rollout.problem import Problem as Problem
    from avrare.rollout.replay import Trace as Trace
else:

    def __getattr__(name: str) -> object:
        import importlib

        if name == "__all__":
            return __dir__()
        modules = find_modules()
        if name in modules:
            value = getattr(importlib.import_module(modules[name]), name)
        elif name.startswith("_"):  # Python asks for some of these by itself
            raise AttributeError(f"module 'avrare' has no attribute {name!r}")
        else:
            from avrare.plugin.provided import load_function

            value = load_function(name)
        globals()[name] = value
        return value


_table.fill(_renderers.RENDERERS)


def __dir__() -> list[str]:
    from avrare.plugin.provided import list_functions

    return sorted([*find_modules(), *list_functions()])


@functools.cache
def find_modules() -> dict[str, str]:
    """Return the module of each public name, read from the imports ``NAME as NAME`` above."""
    import ast
    from pathlib import Path

    statements = ast.walk(ast.parse(Path(__file__).read_text(encoding="utf-8")))
    imports = [node for node in statements if isinstance(node, ast.ImportFrom)]
    return {
        alias.name: statement.module
        for statement in imports
        if statement.module is not None and statement.module.startswith("avrare.")
        for alias in statement.names
        if alias.asname == alias.name
    }
