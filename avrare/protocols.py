"""The seams of avrare: what a simulator, a perception error model, ... must offer.

All of them work on N particles at once (leading axis N) and are deterministic: every random choice is a
transform of the standard normal numbers that they are handed. States are values (see ``avrare.batch``).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from avrare.driving import Action, Observation, Prediction, Vehicles

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Signals = Mapping[str, NDArray[Any]]


@runtime_checkable
class System(Protocol):
    """Anything whose failure probability can be estimated; the closed loop is one too.

    Optional: ``faults(state) -> (N,) bool`` marks rows that have broken down, and
    ``counts(state) -> {name: (N,) int}`` gives counters to report (solver fallbacks, ...). A system that can
    draw from another law than its own offers ``under(law) -> System`` and ``log_weights(state) -> (N,)``, the
    log of p/q along each row.
    """

    noise_size: int

    def initial(self, noise: Floats) -> Any:
        """The state at t = 0 from noise (N, noise_size)."""

    def step(self, state: Any, noise: Floats) -> Any:
        """The next state; must not change ``state``."""

    def signals(self, state: Any) -> Signals:
        """Named arrays with leading axis N, the samples that formulas read."""


class Simulator(Protocol):
    """The world without the stack under test.

    A driving simulator also has ``scene: Scene`` and worlds with ``ego`` and ``others`` (``Vehicles``).
    """

    dt: float
    noise_size: int

    def reset(self, noise: Floats) -> Any:
        """World at t = 0 from noise (N, noise_size)."""

    def step(self, world: Any, action: Any, noise: Floats) -> Any:
        """World one ``dt`` later."""

    def signals(self, world: Any) -> Signals:
        """Named arrays with leading axis N."""


class PerceptionErrorModel(Protocol):
    """Stands for sensors and detector: true world in, erroneous observation out."""

    noise_size: int

    def observe(self, world: Any, noise: Floats) -> Observation:
        """One observation of every other vehicle, from noise (N, noise_size)."""


@runtime_checkable
class PersistentPerceptionErrorModel(PerceptionErrorModel, Protocol):
    """One whose errors last from step to step: the closed loop keeps its memory and calls ``follow``.

    Its ``observe`` is an observation without a past. What it remembers is copied with the particle.
    """

    def start(self, noise: Floats) -> Any:
        """Memory at t = 0, where nothing is observed yet, from noise (N, noise_size)."""

    def follow(self, world: Any, noise: Floats, memory: Any) -> tuple[Observation, Any]:
        """The observation of the next step and the memory after it."""


class Tracker(Protocol):
    """Estimates the state of the others from observations and predicts them."""

    def start(self, world: Any) -> Any:
        """Track that knows the world at t = 0 exactly."""

    def update(self, track: Any, observation: Observation) -> Any:
        """Track one step later; missed detections are predicted through."""

    def predict(self, track: Any, steps: int) -> Prediction:
        """Positions now and over ``steps`` further steps."""


class Controller(Protocol):
    """The planner under test. Its memory (warm start, counters) is copied with the particle."""

    horizon: int

    def start(self, n: int) -> Any:
        """Memory of ``n`` particles before the first step."""

    def act(self, memory: Any, ego: Vehicles, prediction: Prediction | None) -> tuple[Action, Any]:
        """Action for the next step and the memory after it."""


@dataclass(frozen=True)
class Verdict:
    """What a monitor says of the samples 0..t.

    Attributes:
        robustness: (N,) robustness of the prefix at sample 0 (nominal, stl-ams eq. 14).
        violated: (N,) Boolean evaluation of the prefix at sample 0 is false.
        score: (N,) running maximum of how near to failure the particle has come; higher is nearer.
    """

    robustness: Floats
    violated: Bools
    score: Floats


class Specification(Protocol):
    """A formula over signals with an online monitor whose state is a value."""

    def start(self, n: int) -> Any:
        """Monitor state before sample 0."""

    def update(self, state: Any, signals: Signals) -> tuple[Any, Verdict]:
        """Monitor state and verdict after one more sample."""
