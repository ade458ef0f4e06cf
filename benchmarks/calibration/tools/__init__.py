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
        dear: Budget from which on it takes 5 CPU seconds or more for an answer, the mean over problems.
    """

    name: str
    environment: str
    module: str
    interval: str
    settings: Mapping[str, Mapping[str, Any]]
    sized: str
    unable: Callable[[Problem], str] = field(default=lambda problem: "")
    dear: int = 100_000

    @property
    def method(self) -> str:
        """Name of the method to the adapter."""
        return self.name.split(" ", 1)[1]


def needs_steps(problem: Problem) -> str:
    """Say why a splitting of paths cannot express a static problem."""
    return "" if problem.system else "a static problem has no path to split"


def needs_expressions(problem: Problem) -> str:
    """Say why SENTIL, whose models are expressions of its own, was not asked."""
    if not problem.system:
        return "a static problem has no path to split"
    return (
        ""
        if type(problem.system).__name__ in ("Chain", "Lattice")
        else "its model language was tried on chains and lattices only"
    )


def _avrare() -> tuple[Tool, ...]:
    own, size = "its own", "`budget` of B rollouts' steps"
    tuned = {"particles": 500, "discard": 50, "runs": 5}
    return (
        Tool("avrare mc", _HERE, _AVRARE, "Clopper-Pearson", {RECOMMENDED: {}}, "`rollouts` B"),
        Tool("avrare ams", _HERE, _AVRARE, own, {RECOMMENDED: {}, TUNED: tuned}, size, needs_steps),
        Tool("avrare ess", _HERE, _AVRARE, own, {RECOMMENDED: {}, TUNED: {"kernel": "shrink"}}, size),
        Tool("avrare is", _HERE, _AVRARE, own, {RECOMMENDED: {}, TUNED: {"check": 0.3}}, "`rollouts` B"),
        Tool("avrare smc", _HERE, _AVRARE, own, {RECOMMENDED: {}}, size, needs_steps, dear=10_000),
        Tool("avrare auto", _HERE, _AVRARE, own, {RECOMMENDED: {}}, "`rollouts` B"),
    )


def _openturns() -> tuple[Tool, ...]:
    own = "its `getConfidenceLength(0.95)`, about the estimate"
    level, line = "B / 5 a level", "B / 10 directions"

    def tool(
        method: str, sized: str, tuned: Mapping[str, Any] | None = None, dear: int = 100_000, **options: Any
    ) -> Tool:
        settings = {RECOMMENDED: options} | ({TUNED: {**options, **tuned}} if tuned else {})
        return Tool(f"openturns {method}", "openturns", _OT, own, settings, sized, dear=dear)

    return (
        tool("monte carlo", "B at most"),
        tool("subset", level, {"conditional_probability": 0.2}, levels=5),
        tool("directional", line, {"safe": True}, dear=10_000),
        tool("form-is", "what FORM leaves of B"),
        tool("cross-entropy", level, {"quantile": 0.1}, levels=5),
        tool("nais", level, {"quantile": 0.1}, levels=5),
        tool("line", "a tenth of what FORM leaves of B", {"safe": True}, dear=10_000),
    )


def _others() -> tuple[Tool, ...]:
    runs, room = "Student's t of ten runs: one run states none", "benchmarks.calibration.tools."
    deviation = "log-normal, from the coefficient of variation that it states (dependent chains)"
    plain: Mapping[str, Mapping[str, Any]] = {RECOMMENDED: {}}
    return (
        Tool(
            "uqpy subset", "uqpy", f"{room}uqpy_tools", deviation, plain, "B / 5 a level", dear=10_000
        ),
        Tool(
            "pytams tams", "pytams", f"{room}pytams_tools", runs, plain, "ten runs of B / 60 trajectories",
            needs_steps, dear=1_000,
        ),
        Tool(
            "textbook gams", _HERE, f"{room}gams_tools", runs, plain, "ten runs of B / 50 particles",
            needs_steps,
        ),
        Tool(
            "sentil splitting", "sentil", f"{room}sentil_tools", runs, plain,
            "ten runs of B / 500 particles, at least 10; it counts its own simulations", needs_expressions,
        ),
        Tool(
            "verifai cross-entropy", "verifai", f"{room}verifai_tools",
            "Clopper-Pearson of the counterexamples, which its falsifier gives for any sampler", plain,
            "`n_iters` B", dear=10_000,
        ),
    )  # fmt: skip


TOOLS: dict[str, Tool] = {tool.name: tool for tool in (*_avrare(), *_openturns(), *_others())}
