"""Trace of one rollout: its signals over time, as named arrays."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from avrare.base.errors import UsageError
from avrare.base.number_format import format_robustness
from avrare.base.plot import Plot
from avrare.base.records import Records
from avrare.base.renderers import render
from avrare.driving import Scene
from avrare.protocols import Floats
from avrare.rollout.problem import Problem, read_tape
from avrare.rollout.replay import replay_tape, tabulate_signals

if TYPE_CHECKING:
    from xarray import Dataset


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

    def to_xarray(self) -> Dataset:
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

    def plot(self, signals: Sequence[str] = ()) -> Plot:
        """Draw signals over time (needs matplotlib).

        Args:
            signals: Names; by default those of the formula, else the first eight.

        Raises:
            UsageError: No signal has the name.
        """
        plot: Plot = render("plot", self, signals)
        return plot

    def describe(self) -> str:
        """Return ``no_crash fails, robustness -0.12``."""
        return f"{self.specification} {self.outcome}, robustness {format_robustness(self.robustness)}"

    def __repr__(self) -> str:
        return f"<Trace {self.describe()}, {len(self.times)} samples of {', '.join(self.signals)}>"


def trace_tape(problem: Problem, noise: ArrayLike | None = None) -> Trace:
    """Run one tape (steps + 1, noise_size) of a problem, judged by its first specification.

    Without a tape it is the noise-free rollout.

    Raises:
        UsageError: The tape does not fit.
    """
    shape = (problem.steps + 1, problem.noise_size)
    tape = np.zeros(shape) if noise is None else read_tape(noise)
    if tape.ndim == 3:
        raise UsageError(f"trace takes one tape, not {len(tape)}", "result.failures.noise[0] is the first")
    if tape.shape != shape:
        raise UsageError(f"the tape has shape {tape.shape}, but this problem needs {shape}")
    rollout, dt = replay_tape(problem, tape), problem.dt
    formula = problem.monitors[0].formula
    return Trace(
        problem.names[0],
        "" if formula is None else formula.text.strip(),
        rollout.signals,
        np.arange(len(rollout.states), dtype=np.float64) * (1.0 if dt is None else dt),
        rollout.robustness,
        rollout.violated,
        rollout.error,
        tape,
        "step" if dt is None else "s",
        problem.scene,
    )
