"""Protocols of the system and of the seven kinds of component."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from avrare.driving import Action, Observation, Prediction, Vehicles

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Signals = Mapping[str, NDArray[Any]]

WorkT = TypeVar("WorkT", contravariant=True)
ChunkT = TypeVar("ChunkT", contravariant=True)
OutcomeT = TypeVar("OutcomeT", covariant=True)
PlanT = TypeVar("PlanT", contravariant=True)
InfoT = TypeVar("InfoT", covariant=True)
RequestT = TypeVar("RequestT", covariant=True)
RolloutsT = TypeVar("RolloutsT", contravariant=True)
ResultT = TypeVar("ResultT")


@runtime_checkable
class System(Protocol):
    """Anything whose failure probability can be estimated; the closed loop is one too.

    Optional: ``ReportsFaults``, ``CountsEvents``, ``HasNotes``, ``DrawsUnderLaw`` with ``WeighsRollouts``.
    """

    noise_size: int

    def initial(self, noise: Floats) -> Any:
        """Return the state at t = 0 from noise (N, noise_size)."""

    def step(self, state: Any, noise: Floats) -> Any:
        """Return the next state; must not change ``state``."""

    def signals(self, state: Any) -> Signals:
        """Return named arrays with leading axis N, the samples that formulas read."""


class Simulator(Protocol):
    """Simulator: the world without the stack under test (``avrare.stack.features.HasFeatures`` for learning).

    A driving simulator also has a scene (``HasScene``) and worlds with ``ego`` and ``others`` (``Vehicles``).
    Optional: ``ReportsFaults``, ``CountsEvents``, ``HasNotes``, ``HasLimits``, ``NamesNoise``, ``TakesDraws``
    """

    dt: float
    noise_size: int

    def reset(self, noise: Floats) -> Any:
        """Return the world at t = 0 from noise (N, noise_size)."""

    def step(self, world: Any, action: Any, noise: Floats) -> Any:
        """Return the world one ``dt`` later."""

    def signals(self, world: Any) -> Signals:
        """Return named arrays with leading axis N."""


class PerceptionErrorModel(Protocol):
    """Model of sensors and detector: true world in, erroneous observation out.

    Optional: ``HasDensity``, ``NamesNoise``, ``ReportsGhosts``, ``PersistentPerceptionErrorModel``.
    """

    noise_size: int

    def observe(self, world: Any, noise: Floats) -> Observation:
        """Return one observation of every other vehicle, from noise (N, noise_size)."""


@runtime_checkable
class PersistentPerceptionErrorModel(PerceptionErrorModel, Protocol):
    """Perception error model whose errors last from step to step: the closed loop calls ``follow``.

    Its ``observe`` is an observation without a past. Its memory is copied with the particle.
    """

    def start(self, noise: Floats) -> Any:
        """Return the memory at t = 0, where nothing is observed yet, from noise (N, noise_size)."""

    def follow(self, world: Any, noise: Floats, memory: Any) -> tuple[Observation, Any]:
        """Return the observation of the next step and the memory after it."""


class Tracker(Protocol):
    """Tracker: estimates the others' states and predicts them (``HasFeatures``, ``AssociatesDetections``)."""

    def start(self, world: Any) -> Any:
        """Return the track at t = 0, before any observation; it may know the world exactly, or nothing."""

    def update(self, track: Any, observation: Observation) -> Any:
        """Return the track one step later; missed detections are predicted through."""

    def predict(self, track: Any, steps: int) -> Prediction:
        """Return positions now and over ``steps`` further steps, inf for a vehicle without a track."""


class Controller(Protocol):
    """Planner under test. Its memory (warm start, counters) is copied with the particle.

    Optional: ``CountsEvents``, ``HasFeatures``; a memory may have a plan (``HasPlan``).
    """

    horizon: int

    def start(self, n: int) -> Any:
        """Return the memory of ``n`` particles before the first step."""

    def act(self, memory: Any, ego: Vehicles, prediction: Prediction | None) -> tuple[Action, Any]:
        """Return the action for the next step and the memory after it."""


@dataclass(frozen=True)
class Verdict:
    """Verdict of a monitor on the samples 0..t.

    Attributes:
        robustness: (N,) robustness of the prefix at sample 0 (nominal, stl-ams eq. 14).
        violated: (N,) Boolean evaluation of the prefix at sample 0 is false.
        score: (N,) running maximum of how near to failure the particle has come; higher is nearer.
    """

    robustness: Floats
    violated: Bools
    score: Floats


class Specification(Protocol):
    """Formula over signals with an online monitor whose state is a value.

    Optional: ``HasFormula``, ``HasMargin``, ``SelectsSamples``, ``ExplainsViolation``, ``NamesVehicles``,
    ``ExcludesVehicles``.
    """

    def start(self, n: int) -> Any:
        """Return the monitor state before sample 0."""

    def update(self, state: Any, signals: Signals) -> tuple[Any, Verdict]:
        """Return the monitor state and the verdict after one more sample."""


class Estimator(Protocol[PlanT, RequestT, RolloutsT, InfoT, ResultT]):
    """Estimator: owns no loop, but asks for rollouts and is given their outcome.

    ``avrare.estimation.plan.plan.Estimator`` names the value types. Optional: ``PreparesProblem``,
    ``NeedsCapabilities``, ``StopsEarly``, ``RebuildsCarries``, ``ScalesToCost`` (``estimation.cross_check``).

    Attributes:
        name: Name in results.
        single: True where it estimates one specification at a time.
    """

    name: str
    single: bool

    def init(self, plan: PlanT) -> tuple[Any, InfoT]:
        """Return the state before the first rollout, and the progress to show."""

    def ask(self, state: Any) -> RequestT | None:
        """Return the next rollouts to run, or None when done."""

    def tell(self, state: Any, rollouts: RolloutsT) -> tuple[Any, InfoT]:
        """Return the state after the rollouts asked for, and the progress to show."""

    def estimate(self, state: Any) -> list[ResultT]:
        """Return one result per specification."""


class Executor(Protocol[WorkT, ChunkT, OutcomeT]):
    """Executor: an ordered map over chunks of rollouts, and over errands.

    It hands both to ``run`` of the work. ``avrare.rollout.executors.work.Executor`` names the value types.
    Optional: ``ReplacesWorkers``.
    """

    def open(self, work: WorkT) -> None:
        """Prepare the workers for chunks of ``work``."""

    def map(self, chunks: Iterable[ChunkT]) -> Iterator[OutcomeT]:
        """Yield outcomes in the order of the chunks; take a chunk no sooner than there is room for it."""

    def close(self) -> None:
        """Stop the workers."""


PROTOCOLS: dict[str, type[Any]] = {
    "simulator": Simulator,
    "perception": PerceptionErrorModel,
    "tracker": Tracker,
    "controller": Controller,
    "specification": Specification,
    "estimator": Estimator,
    "executor": Executor,
}
"""Protocol of each kind, whose members a part must have."""


def missing_members(kind: str, part: object) -> list[str]:
    """Return the members of its kind's protocol that a part lacks."""
    protocol = PROTOCOLS[kind]
    members = [*protocol.__annotations__, *(name for name in vars(protocol) if not name.startswith("_"))]
    return [name for name in members if not hasattr(part, name)]
