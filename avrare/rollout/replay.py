"""Replay of noise tapes: signals, states, observations and plans of every step; traces of rollouts."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from avrare.base import batch
from avrare.base.errors import UsageError
from avrare.base.number_format import format_robustness
from avrare.base.plot import Plot
from avrare.base.records import Records
from avrare.base.renderers import render
from avrare.driving import Scene
from avrare.protocols import Floats, Misreading, Signals
from avrare.rollout.problem import Problem, read_tape
from avrare.rollout.request import Integers, Rollouts
from avrare.stack.closed_loop import ClosedLoop

if TYPE_CHECKING:
    from xarray import Dataset


@dataclass(frozen=True)
class ReplayedRollout:
    """Rollout of one noise tape, judged by the first specification."""

    signals: dict[
        str, NDArray[Any]
    ]  # (T, ...): T is steps + 1, or less where the rollout broke down or ended
    states: tuple[Any, ...]  # T states of the system, one particle each
    robustness: float  # of the samples before the error, if any
    violated: bool
    error: str | None  # reason of the breakdown
    misreadings: Mapping[str, Misreading]  # (T,), by the name of a noise number

    @property
    def outcome(self) -> str:
        """``fails``, ``passes`` or ``error``."""
        if self.error is not None:
            return "error"
        return "fails" if self.violated else "passes"


def replay_tape(problem: Problem, tape: Floats) -> ReplayedRollout:
    """Replay one noise tape (steps + 1, noise_size)."""
    return replay_tapes(problem, tape[None])[0]


def replay_tapes(problem: Problem, tapes: Floats) -> list[ReplayedRollout]:
    """Replay noise tapes (N, steps + 1, noise_size) in batches."""
    rows = max(4000 // (problem.steps + 1), 1)  # states held at once; a single long rollout may have more
    parts = [_replay_batch(problem, tapes[begin : begin + rows]) for begin in range(0, len(tapes), rows)]
    return [rollout for part in parts for rollout in part]


def _replay_batch(problem: Problem, tapes: Floats) -> list[ReplayedRollout]:
    outcome = problem.replay(tapes, keep_carries=True)
    over = np.zeros(len(tapes), dtype=bool)
    samples: list[_Sample] = []
    for _, rows, carry in outcome.carries:
        going = ~over[rows]
        rows, state = rows[going], batch.take(carry.system, going)
        ended = problem.system.ended(state)
        if ended is not None:
            over[rows] = ended
        system = problem.system
        samples.append(_Sample(rows, system.signals(state), state, system.misreadings(state)))
    return [_extract_row(outcome, samples, row) for row in range(len(tapes))]


class _Sample(NamedTuple):
    """Sample of the rows that are still going."""

    rows: Integers
    signals: Signals
    state: Any
    misreadings: Mapping[str, Misreading]


def _extract_row(outcome: Rollouts, samples: list[_Sample], row: int) -> ReplayedRollout:
    path = [(int(np.searchsorted(sample.rows, row)), sample) for sample in samples if row in sample.rows]
    names = path[0][1].signals if path else ()
    signals = {name: np.stack([sample.signals[name][k] for k, sample in path]) for name in names}
    states = tuple(batch.take(sample.state, np.array([k])) for k, sample in path)
    error = "; ".join(outcome.messages) or "no reason given" if outcome.error[row] else None
    return ReplayedRollout(
        signals,
        states,
        float(outcome.robustness[row, 0]),
        bool(outcome.violated[row, 0]),
        error,
        _extract_misreadings(path),
    )


def _extract_misreadings(path: Sequence[tuple[int, _Sample]]) -> dict[str, Misreading]:
    # Before the first observation nothing is wrong.
    words = {name: reading for _, sample in path for name, reading in sample.misreadings.items()}
    series = {name: np.zeros((2, len(path))) for name in words}
    for t, (k, sample) in enumerate(path):
        for name, reading in sample.misreadings.items():
            usual = np.broadcast_to(reading.usual, reading.values.shape)
            series[name][:, t] = reading.values[k], usual[k]
    return {
        name: replace(reading, values=series[name][0], usual=series[name][1])
        for name, reading in words.items()
    }


def tabulate_signals(signals: Signals, scene: Scene | None = None) -> tuple[tuple[str, ...], Floats]:
    """Return names (K,) and values (T, K) of all numbers of the signals (T, ...), by name.

    An entry for each other vehicle is named by the vehicle: ``others_x[van]``.
    """
    columns: list[str] = []
    blocks: list[Floats] = []
    for name in sorted(signals):
        values = np.asarray(signals[name], dtype=np.float64)
        entries = [",".join(map(str, index)) for index in np.ndindex(values.shape[1:])]
        if scene is not None and values.shape[1:] == (len(scene.names),):
            entries = list(scene.names)
        columns += [f"{name}[{entry}]" if values.ndim > 1 else name for entry in entries]
        blocks.append(values.reshape(len(values), len(entries)))
    return tuple(columns), np.concatenate(blocks, axis=1) if blocks else np.zeros((0, 0))


@dataclass(frozen=True)
class Frame:
    """Step ``t`` of one rollout (N = 1) with the planned x and y (H + 1, >= 2); None: there is none."""

    t: int
    world: Any
    observation: Any = None
    prediction: Any = None
    plan: Floats | None = None


def extract_frames(problem: Problem, rollout: ReplayedRollout) -> list[Frame]:
    """Return the perceived, predicted and planned motion at every step; none without vehicles."""
    loop = problem.system
    if problem.scene is None or not isinstance(loop, ClosedLoop):
        return []
    return make_frames(loop, rollout)


def make_frames(loop: ClosedLoop, rollout: ReplayedRollout) -> list[Frame]:
    """Return the perceived, predicted and planned motion at every step of a loop with vehicles."""
    controller = loop.controller
    horizon = controller.horizon if controller is not None else 0
    frames = []
    for t, state in enumerate(rollout.states):
        prediction = loop.tracker.predict(state.track, horizon) if loop.tracker is not None else None
        plan = controller.plan(state.memory) if controller is not None and t > 0 else None
        frames.append(Frame(t, state.world, state.observation, prediction, None if plan is None else plan[0]))
    return frames


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
