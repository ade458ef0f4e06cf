"""Trace of one rollout: its signals over time, as named arrays."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from avrare.base.errors import UsageError, did_you_mean
from avrare.base.number_format import format_robustness
from avrare.base.records import Records
from avrare.driving import Scene
from avrare.estimation.result.result import Result
from avrare.logic.formula import find_formula
from avrare.output.plots import hide_spines, make_figure
from avrare.output.session.plot import Plot
from avrare.protocols import Floats
from avrare.rollout.problem import Problem, read_tape
from avrare.rollout.replay import replay_tape, tabulate_signals

_MAX_PANELS = 8
_SAFE, _VIOLATED = "#1b6ca8", "#b0443c"


@dataclass(frozen=True, repr=False)
class Trace(Mapping[str, NDArray[Any]]):
    """Signals of one rollout: ``trace["height"]`` is an array (T, ...).

    T is steps + 1, or less where the rollout ended in an error.

    Attributes:
        specification: Name of the specification that judges the rollout.
        formula: Its text; empty where it has none.
        signals: Values by name.
        times: Times (T,) [s], or step numbers where the system has no ``dt``.
        robustness: Robustness of the rollout.
        violated: Whether the rollout violates the specification.
        error: Reason why the rollout broke down, or None.
        noise: Its tape (steps + 1, noise_size).
        scene: Road, sizes and names of a driving simulator, else None.
    """

    specification: str
    formula: str
    signals: Mapping[str, NDArray[Any]]
    times: Floats
    robustness: float
    violated: bool
    error: str | None
    noise: Floats
    unit: str = "s"
    scene: Scene | None = field(default=None, repr=False)

    def __getitem__(self, name: str) -> NDArray[Any]:
        return self.signals[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.signals)

    def __len__(self) -> int:
        return len(self.signals)

    @property
    def outcome(self) -> str:
        """``fails``, ``passes`` or ``error``."""
        return "error" if self.error is not None else "fails" if self.violated else "passes"

    def table(self) -> Records:
        """Return a row for each sample; entries of vehicles are named ``others_x[van]``."""
        names, values = tabulate_signals(self.signals, self.scene)
        rows = zip(self.times, values, strict=True)
        return Records(
            {"time": float(time), **dict(zip(names, map(float, row), strict=True))} for time, row in rows
        )

    def to_xarray(self) -> Any:
        """Return an ``xarray.Dataset`` with the dimension ``time``; axes of vehicles are named ``vehicle``.

        Raises:
            UsageError: xarray is not installed.
        """
        try:
            import xarray
        except ImportError:
            raise UsageError(
                "to_xarray needs xarray", "pip install xarray; or use the arrays by name"
            ) from None
        vehicles = () if self.scene is None else tuple(self.scene.names)
        variables: dict[str, Any] = {}
        for name, values in self.signals.items():
            by_vehicle = bool(vehicles) and values.shape[1:] == (len(vehicles),)
            axes = ("vehicle",) if by_vehicle else tuple(f"{name}_{k}" for k in range(values.ndim - 1))
            variables[name] = (("time", *axes), values)
        coordinates: dict[str, Any] = {"time": self.times} | ({"vehicle": list(vehicles)} if vehicles else {})
        facts = {
            "specification": self.specification,
            "formula": self.formula,
            "robustness": self.robustness,
            "outcome": self.outcome,
        }
        return xarray.Dataset(variables, coordinates, facts)

    def plot(self, signals: Sequence[str] | None = None) -> Plot:
        """Draw signals over time (needs matplotlib).

        Args:
            signals: Names; by default those of the formula, else the first eight.

        Raises:
            UsageError: There is no such signal.
        """
        names = self._choose(signals)
        figure = make_figure(8.0, 0.7 + 1.3 * len(names))
        axes = np.atleast_1d(figure.subplots(len(names), 1, sharex=True))
        colour = _VIOLATED if self.violated else _SAFE
        for ax, name in zip(axes, names, strict=True):
            values = np.asarray(self.signals[name], dtype=np.float64).reshape(len(self.times), -1)
            labels = self._label(name, values.shape[1])
            for column, label in zip(values.T, labels, strict=True):
                ax.plot(self.times, column, lw=1.4, color=colour if len(labels) == 1 else None, label=label)
            if 1 < len(labels) <= _MAX_PANELS:
                ax.legend(fontsize=7, frameon=False, ncols=2)
            ax.set_ylabel(name, fontsize=8)
            ax.tick_params(labelsize=8)
            ax.margins(x=0.0)
            hide_spines(ax, "top", "right")
        axes[-1].set_xlabel("time [s]" if self.unit == "s" else "step", fontsize=9)
        figure.suptitle(self._describe(), fontsize=10)
        return Plot(figure)

    def _choose(self, signals: Sequence[str] | None) -> list[str]:
        for name in signals or ():
            if name not in self.signals:
                raise UsageError(f"the trace has no signal {name!r}", did_you_mean(name, self.signals))
        if signals:
            return list(signals)
        shown = {name: x for name, x in self.signals.items() if np.asarray(x).dtype.kind in "fiub"}
        used = [name for name in shown if name in self.formula]
        return (used or list(shown))[:_MAX_PANELS]

    def _label(self, name: str, count: int) -> list[str]:
        if self.scene is not None and count == len(self.scene.names):
            return list(self.scene.names)
        return [name] if count == 1 else [f"{name}[{k}]" for k in range(count)]

    def _describe(self) -> str:
        return f"{self.specification} {self.outcome}, robustness {format_robustness(self.robustness)}"

    def __repr__(self) -> str:
        return f"<Trace {self._describe()}, {len(self.times)} samples of {', '.join(self.signals)}>"


def trace_problem(problem: Problem, noise: Any = None) -> Trace:
    """Run one tape of ``problem`` and return the trace; see ``Problem.trace``."""
    shape = (problem.steps + 1, problem.noise_size)
    tape = np.zeros(shape) if noise is None else read_tape(getattr(noise, "noise", noise))
    if tape.ndim == 3:
        raise UsageError(
            f"trace takes one tape, not {len(tape)}",
            "problem.trace(result.failures.noise[0]) takes the first",
        )
    if tape.shape != shape:
        raise UsageError(f"the tape has shape {tape.shape}, but this problem needs {shape}")
    rollout = replay_tape(problem, tape)
    scenario = getattr(problem, "scenario", None)
    simulator = getattr(problem.system, "simulator", problem.system)
    dt = getattr(simulator, "dt", None)
    times: Floats = np.arange(len(rollout.states), dtype=np.float64) * (1.0 if dt is None else float(dt))
    formula = find_formula(problem.monitors[0])
    return Trace(
        problem.names[0],
        "" if formula is None else formula.text.strip(),
        rollout.signals,
        times,
        rollout.robustness,
        rollout.violated,
        rollout.error,
        tape,
        "s" if dt is not None else "step",
        None if scenario is None else scenario.scene,
    )


def trace_result(result: Result, index: int | None) -> Trace:
    """Replay the least robust rollout of a result, or one of its kept failures."""
    problem = result.require_origin().problem
    if index is None:
        if np.isnan(result.worst.robustness):
            raise UsageError("every rollout ended in an error, so there is none to trace")
        return trace_problem(problem, result.worst)
    kept = len(result.failures.robustness)
    if not 0 <= index < kept:
        hint = f"it keeps {kept} failures, numbered from 0" if kept else "no rollout failed"
        raise UsageError(f"the result has no failure {index}", hint)
    return trace_problem(problem, result.failures.noise[index])
