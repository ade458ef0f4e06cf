"""Protocols between the parts of avrare: the seven kinds of component, and their optional abilities.

All parts work on N particles at once (leading axis N) and are deterministic: every random choice is a
transform of the standard normal numbers handed to it. States are values (see ``avrare.base.batch``).

An optional ability is a set of members that a part may have beyond its kind. ``find_ability`` is the one way
in which avrare asks for them; a member that is None counts as absent.
"""

from __future__ import annotations

import functools
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from avrare.driving import Action, Observation, Prediction, Scene, Vehicles

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Signals = Mapping[str, NDArray[Any]]

AbilityT = TypeVar("AbilityT")
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

    ``avrare.estimation.plan.Estimator`` names the value types. Optional: ``PreparesProblem``,
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
    """Executor: an ordered map over chunks of rollouts.

    ``avrare.rollout.executors.work.Executor`` names the value types. Optional: ``ReplacesWorkers``.
    """

    def open(self, work: WorkT) -> None:
        """Prepare the workers for chunks of ``work``."""

    def map(self, chunks: Iterable[ChunkT]) -> Iterator[OutcomeT]:
        """Yield outcomes in the order of the chunks; take a chunk no sooner than there is room for it."""

    def close(self) -> None:
        """Stop the workers."""


def find_ability(part: object, ability: type[AbilityT]) -> AbilityT | None:
    """Return ``part`` if it has every member of the protocol ``ability``, else None.

    Members are looked up with ``getattr``, so that wrappers may forward them.
    """
    found = all(getattr(part, name, None) is not None for name in _members(ability))  # type: ignore[arg-type]
    return part if found else None  # type: ignore[return-value]


@functools.cache
def _members(ability: Any) -> tuple[str, ...]:
    return tuple(name for name in (*vars(ability), *ability.__annotations__) if not name.startswith("_"))


def forward_abilities(wrapper: object, part: object, *abilities: type) -> None:
    """Give ``wrapper`` the members of ``abilities`` that ``part`` has, as attributes."""
    for ability in abilities:
        for name in _members(ability):
            if hasattr(part, name):
                setattr(wrapper, name, getattr(part, name))


# Optional abilities of systems and simulators


class ReportsFaults(Protocol):
    """System or simulator that marks rows that have broken down."""

    def faults(self, state: Any, /) -> Bools:
        """Return (N,) True for rows that have broken down."""


class CountsEvents(Protocol):
    """System, simulator or controller with counters to report, such as a solver's fallbacks."""

    def counts(self, state: Any, /) -> Mapping[str, NDArray[np.int64]]:
        """Return counters (N,) by name, of a state (of a controller: of its memory)."""


class HasNotes(Protocol):
    """System or simulator with health warnings that every result must carry: texts by name."""

    notes: Mapping[str, str]


class HasLimits(Protocol):
    """Simulator without some capabilities (``avrare.worlds.capabilities``): reasons by missing capability."""

    lacks: Mapping[str, str]


class HasScene(Protocol):
    """Driving simulator; its road, sizes and names do not change during a rollout."""

    scene: Scene


class HasSimulator(Protocol):
    """System that is built around a simulator, such as the closed loop."""

    simulator: Any


class DrawsUnderLaw(Protocol):
    """System that can draw from another distribution than its own."""

    def under(self, law: Any) -> Any:
        """Return the system that draws from ``law``; it also has ``WeighsRollouts``."""


class WeighsRollouts(Protocol):
    """System that draws from another distribution q than the one p that is meant."""

    def log_weights(self, state: Any) -> Floats:
        """Return (N,) the log likelihood ratio p/q along each row so far."""


class OffersWeights(Protocol):
    """System that runs only for an estimator that takes weights into account."""

    def with_weights(self) -> Any:
        """Return the same system, ready to run; it also has ``WeighsRollouts``."""


# Optional abilities of perception error models, proposals and controllers


class HasDensity(Protocol):
    """Perception error model with a log density, so that another one can be its proposal."""

    def log_prob(self, world: Any, observation: Any) -> Floats:
        """Return (N,) the log density of an observation of a world."""


class AdaptsToTarget(Protocol):
    """Proposal that is made for one target: a recipe for a perception error model."""

    def for_target(self, target: Any) -> Any:
        """Return the proposal for the perception error model ``target``."""


class HasPlan(Protocol):
    """Controller memory with the planned motion (N, H + 1, >= 2), x and y first, for pictures."""

    plan_states: Floats


# Optional abilities of specifications


class HasFormula(Protocol):
    """Specification that monitors one formula (``avrare.logic.formula.Formula``)."""

    formula: Any


class HasMargin(Protocol):
    """Specification of the shape "always φ" that can evaluate φ at the newest sample."""

    def margin(self, state: Any) -> Floats | None:
        """Return (N,) robustness of φ at the newest sample, None for other shapes."""


class SelectsSamples(Protocol):
    """Specification whose formula, which orders the particles, reads other signals than the system's."""

    def sample(self, signals: Signals) -> Signals:
        """Return the signals of the formula from those of the system."""


class ExplainsViolation(Protocol):
    """Specification that says in words what violates it at the start."""

    def explain(self, signals: Signals) -> str:
        """Return the cause of a violation at sample 0."""


class NamesVehicles(Protocol):
    """Specification whose quantifiers range over vehicles of these names."""

    names: tuple[str, ...]


class ExcludesVehicles(Protocol):
    """Specification that leaves out the vehicles of these names."""

    excluded: tuple[str, ...]


# Optional abilities of estimators and executors


class PreparesProblem(Protocol):
    """Estimator that puts another problem in the place of the one given."""

    def prepare(self, problem: Any) -> Any:
        """Return the problem to estimate; may run rollouts to set itself up."""


class NeedsCapabilities(Protocol):
    """Estimator that is refused where a simulator lacks (``HasLimits``) "branches" or "noise"."""

    needs: tuple[str, ...]


class StopsEarly(Protocol):
    """Estimator whose rollouts may end before the last step."""

    stops_early: bool


class RebuildsCarries(Protocol):
    """Estimator that can do without the carries of a stage read from a checkpoint."""

    rebuilds_carries: bool


class ReplacesWorkers(Protocol):
    """Executor that replaces workers that die, and counts how often."""

    restarts: int


def find_scene(simulator: object) -> Scene | None:
    """Return the scene of a driving simulator, None for any other."""
    driving = find_ability(simulator, HasScene)
    return driving.scene if driving is not None else None


def find_simulator(system: object) -> object:
    """Return the simulator that a system is built around, or the system itself."""
    loop = find_ability(system, HasSimulator)
    return loop.simulator if loop is not None else system


def find_notes(system: object) -> Mapping[str, str]:
    """Return the health warnings that a system, or its simulator, puts on every result."""
    noted = find_ability(find_simulator(system), HasNotes)
    return noted.notes if noted is not None else {}
