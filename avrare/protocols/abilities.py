"""Protocols of the optional abilities: members that a part may have beyond its kind."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from avrare.driving import Scene
from avrare.protocols.kinds import Bools, Floats, Signals

AbilityT = TypeVar("AbilityT")


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


class LimitsSteps(Protocol):
    """System or simulator that goes on for so many steps only, such as one that repeats a recording."""

    def check_steps(self, steps: int) -> None:
        """Raise the ``UsageError`` of a rollout that has too many steps."""


class HasStepTime(Protocol):
    """System or simulator with a time of a step [s]."""

    dt: float


class HasScene(Protocol):
    """Driving simulator; its road, sizes and names do not change during a rollout."""

    scene: Scene


class HasJunction(Protocol):
    """Simulator whose scene is no road, but an intersection for the rules of intersections."""

    junction: Scene


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


def find_judged_scene(simulator: object) -> Scene | None:
    """Return what specifications know of the scene: that of a driving simulator, or an intersection."""
    crossing = find_ability(simulator, HasJunction)
    return find_scene(simulator) or (crossing.junction if crossing is not None else None)


def find_simulator(system: object) -> object:
    """Return the simulator that a system is built around, or the system itself."""
    loop = find_ability(system, HasSimulator)
    return loop.simulator if loop is not None else system


def check_steps(system: object, steps: int) -> None:
    """Raise the ``UsageError`` of a system, or of its simulator, that does not go on for so many steps."""
    limited = find_ability(find_simulator(system), LimitsSteps)
    if limited is not None:
        limited.check_steps(steps)


def find_notes(system: object) -> Mapping[str, str]:
    """Return the health warnings that a system, or its simulator, puts on every result."""
    noted = find_ability(find_simulator(system), HasNotes)
    return noted.notes if noted is not None else {}
