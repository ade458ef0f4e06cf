"""Tools of the benchmark: their adapters, environments, settings, and where their intervals come from."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from benchmarks.calibration.problems.problem import Problem

RECOMMENDED, TUNED = "recommended", "tuned"
_HERE = "here"
"""Environment of the benchmark itself."""
_OT = "benchmarks.calibration.tools.openturns_tools"
_AVRARE = "benchmarks.calibration.tools.avrare_tools"


@dataclass(frozen=True)
class Tool:
    """A method of a tool.

    Attributes:
        name: Name, "tool method".
        environment: Name of its environment (``environments.py``).
        module: Adapter, with ``estimate`` and ``tool_version``.
        interval: Where its interval comes from.
        settings: Options of the adapter by the name of the setting.
        sized: How a budget of B evaluations is given to it.
        unable: Function to the reason for which it cannot express a problem, or "".
    """

    name: str
    environment: str
    module: str
    interval: str
    settings: Mapping[str, Mapping[str, Any]]
    sized: str
    unable: Callable[[Problem], str] = field(default=lambda problem: "")

    @property
    def method(self) -> str:
        """Name of the method to the adapter."""
        return self.name.split(" ", 1)[1]


def needs_steps(problem: Problem) -> str:
    """Say why a splitting of paths cannot express a static problem."""
    return "" if problem.system else "a static problem has no path to split"


def _avrare() -> tuple[Tool, ...]:
    own = "avrare's own, at 95 %"
    size = "`budget` of B rollouts' steps"
    return (
        Tool("avrare mc", _HERE, _AVRARE, "Clopper-Pearson", {RECOMMENDED: {}}, "`rollouts` B"),
        Tool("avrare ams", _HERE, _AVRARE, own, {RECOMMENDED: {}}, size, needs_steps),
    )


def _openturns() -> tuple[Tool, ...]:
    own = "its `getConfidenceLength(0.95)`, about the estimate"
    level = "B / 5 evaluations a level"
    five: dict[str, Any] = {"levels": 5}
    return (
        Tool("openturns monte carlo", "openturns", _OT, own, {RECOMMENDED: {}}, "B at most"),
        Tool("openturns subset", "openturns", _OT, own, {RECOMMENDED: five}, level),
    )


TOOLS: dict[str, Tool] = {tool.name: tool for tool in (*_avrare(), *_openturns())}
