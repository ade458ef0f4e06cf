"""Contracts: base classes of the system and of the seven kinds of part.

All parts work on N particles at once (leading axis N) and are deterministic: every random choice is a
transform of the standard normal numbers handed to them. A state, world, track or memory is a value: a
dataclass or dict of arrays with leading axis N that no method changes. A class without the base class works
too, if it has the members without a default: ``adapt`` adds the others.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from avrare.base.errors import UsageError
from avrare.driving import Observation, Prediction, Scene
from avrare.protocols.values import Bools, Floats, Misreading, Signals, Verdict

WorkT = TypeVar("WorkT")
ChunkT = TypeVar("ChunkT")
OutcomeT = TypeVar("OutcomeT")
PlanT = TypeVar("PlanT")
InfoT = TypeVar("InfoT")
RequestT = TypeVar("RequestT")
RolloutsT = TypeVar("RolloutsT")
ResultT = TypeVar("ResultT")


class _Dynamics(ABC):  # shared by systems and simulators
    noise_size: int
    noise_names: Sequence[str] | None = None
    perfect_noise: Sequence[float] | Floats | None = None
    scene: Scene | None = None
    lacks: Mapping[str, str] | None = None
    warnings: Mapping[str, str] = {}

    def check_steps(self, steps: int) -> None:  # noqa: B027 (its default)
        """Raise a ``UsageError`` where rollouts cannot have this number of steps. Default: they can."""

    def faults(self, state: Any) -> Bools | None:
        """Return (N,) True for rows that have broken down; called after every step. Default: None, no row."""
        return None

    def ended(self, state: Any) -> Bools | None:
        """Return a mask (N,) of the rows that have ended: no later sample counts. Default: None, no row."""
        return None

    def counts(self, state: Any) -> Mapping[str, NDArray[np.int64]]:
        """Return counters (N,) by name, which results sum up; called where a rollout ends. Default: none."""
        return {}

    def misreadings(self, state: Any) -> Mapping[str, Misreading]:
        """Return, for reports, the errors of perception by noise name. Default: none; reports give sigmas."""
        return {}

    def features(self, state: Any) -> Floats | None:
        """Return (N, F) numbers that tell how a rollout may go on. Default: None, signals and vehicles."""
        return None


class System(_Dynamics):
    """System: anything whose failure probability can be estimated; the closed loop is one.

    Attributes:
        noise_size: Number of standard normal numbers of the start, and of each step.
        dt: Time of a step [s], which formulas in seconds use. Default: None.
        noise_names: Name of each number for reports, such as "lateral error of cut_in". Default: numbered.
        perfect_noise: Value of each number where no error is made. Default: zeros.
        scene: Road, sizes and names of a driving system. Default: None.
        lacks: Reasons by missing capability: "branches" (continuing from a copied state), "noise" (the same
            noise gives the same rollout). Default: None, it has both.
        warnings: Health warnings for every result, texts by name. Default: none.
    """

    dt: float | None = None

    @abstractmethod
    def initial(self, noise: Floats) -> Any:
        """Return the state at t = 0 from noise (N, noise_size); called once a rollout."""

    @abstractmethod
    def step(self, state: Any, noise: Floats) -> Any:
        """Return the state one step later, from noise (N, noise_size)."""

    @abstractmethod
    def signals(self, state: Any) -> Signals:
        """Return arrays (N, ...) by name, which formulas read; called at t = 0 and after each step."""

    def under(self, law: Any) -> System:
        """Return the system, with ``log_weights``, that draws from a law. Default: a ``UsageError``."""
        hint = "a system that can offers under(law) -> system and log_weights(state) -> (N,)"
        raise UsageError(f"{type(self).__name__} cannot draw from another law", hint)

    def with_weights(self) -> System:
        """Return the system for an estimator that takes weights into account. Default: itself."""
        return self

    def log_weights(self, state: Any) -> Floats | None:
        """Return (N,) log p/q at each sample: p is meant, q is drawn from. Default: None, the same."""
        return None


class Simulator(_Dynamics):
    """Simulator: the world without the stack under test.

    Worlds of driving have ``ego`` and ``others``; of others a controller sees the signals (N, d), in order.

    Attributes:
        dt: Time of a step [s].
        junction: Scene without lanes, in the plane, in place of ``scene``. Default: None.
        noise_size, noise_names, perfect_noise, scene, lacks, warnings: As of a ``System``.
    """

    dt: float
    junction: Scene | None = None

    @abstractmethod
    def reset(self, noise: Floats) -> Any:
        """Return the world at t = 0 from noise (N, noise_size); called once a rollout."""

    @abstractmethod
    def step(self, world: Any, action: Any, noise: Floats) -> Any:
        """Return the world one ``dt`` later; ``action`` is the controller's, None without one."""

    @abstractmethod
    def signals(self, world: Any) -> Signals:
        """Return arrays (N, ...) by name, which formulas read; called at t = 0 and after each step."""

    def drawing(self, laws: Mapping[str, Any]) -> Simulator:
        """Return the simulator whose options are drawn by these laws, by the place of each option.

        Called once, where a scenario draws options (``avrare.plugin.Drawable``); it has ``reset_drawn``.
        """
        raise NotImplementedError

    def reset_drawn(self, noise: Floats, values: Mapping[str, Floats]) -> Any:
        """Return the world at t = 0 with drawn values (N,) of the options; called in place of ``reset``."""
        raise NotImplementedError

    def impossible(self, world: Any) -> Bools | None:
        """Return (N,) True for impossible starts: they are drawn again. Default: None, all are possible."""
        return None


class PerceptionErrorModel(ABC):
    """Model of sensors and detector: true world in, erroneous observation out.

    Attributes:
        noise_size: Number of standard normal numbers of each step.
        noise_names, perfect_noise, warnings: As of a ``System``.
        ghost_slots: Columns of an observation for false detections, after the vehicles'. Default: 0.
    """

    noise_size: int
    noise_names: Sequence[str] | None = None
    perfect_noise: Sequence[float] | Floats | None = None
    warnings: Mapping[str, str] = {}
    ghost_slots: int = 0

    @abstractmethod
    def observe(self, world: Any, noise: Floats) -> Observation:
        """Return one observation of every other vehicle, without a past, from noise (N, noise_size).

        Its arrays have columns of the vehicles, then ``ghost_slots``, and are NaN where nothing is seen.
        """

    def start(self, noise: Floats) -> Any:
        """Return the memory at t = 0, where nothing is observed yet. Default: None, errors do not last."""
        return None

    def follow(self, world: Any, noise: Floats, memory: Any) -> tuple[Observation, Any]:
        """Return the observation of a step and the memory after it; called after each step of the world.

        Default: ``observe``, and the memory as it is. With its own, errors last; it has no ``log_prob``.
        """
        return self.observe(world, noise), memory

    def locate(self, ego: Any, memory: Any) -> Any:
        """Return the ego state that the planner assumes; called before each step. Default: the true one."""
        return ego

    def features(self, memory: Any) -> Floats | None:
        """Return (N, F) numbers as ``System.features`` does. Default: None."""
        return None

    def log_prob(self, world: Any, observation: Observation) -> Floats:
        """Return (N,) log density of an observation of a world, for importance sampling.

        Called after each step. Without it the model can neither be a proposal nor have one.
        """
        raise NotImplementedError

    def log_ratio(
        self, world: Any, noise: Floats, memory: Any, other: Any, other_memory: Any
    ) -> tuple[Floats, Any]:
        """Return (N,) log density ratio of ``other`` for the observation from ``noise``, and its memory.

        It is NaN where ``other`` may give an observation that this model cannot. ``memory`` is that before
        the step, and ``other_memory`` that of the tape on which ``other`` would have observed the same; both
        are None where errors do not last. Called where failures are reweighed for a nearby model.
        """
        raise NotImplementedError


class Tracker(ABC):
    """Tracker: estimates the others' states and predicts them.

    Attributes:
        known_scene: Scene for the controller, of a tracker that finds out itself which detection is of which
            track: the simulator's vehicles, then others. Default: None, observations say it.
        burn_in: Number of observations up to t = 0 with which a drive begins. Default: 0.
    """

    known_scene: Scene | None = None
    burn_in: int = 0

    @abstractmethod
    def start(self, world: Any) -> Any:
        """Return the track at t = 0, before any observation; it may know the world exactly, or nothing."""

    @abstractmethod
    def update(self, track: Any, observation: Observation) -> Any:
        """Return the track one step later; missed detections are predicted through."""

    @abstractmethod
    def predict(self, track: Any, steps: int) -> Prediction:
        """Return positions now and over the controller's horizon, before each step; inf without a track."""

    def features(self, track: Any) -> Floats | None:
        """Return (N, F) numbers as ``System.features`` does. Default: None, the errors of the tracks."""
        return None


class Controller(ABC):
    """Planner under test.

    Attributes:
        horizon: Number of steps that it wants predicted. Default: 0.
        sees_truth: True where its predictions are of the true vehicles, not the tracker's. Default: False.
        arrays: Arrays by name that the option ``arrays`` replaces, such as a network's. Default: none.
    """

    horizon: int = 0
    sees_truth: bool = False
    arrays: Mapping[str, Any] = {}

    def start(self, n: int) -> Any:  # noqa: B027 (its default)
        """Return the memory (warm start, counters) of ``n`` particles before a step. Default: None."""

    @abstractmethod
    def act(self, memory: Any, ego: Any, prediction: Prediction | None) -> tuple[Any, Any]:
        """Return the action for the next step and the memory after it; called before each step.

        In driving ``ego`` is ``avrare.driving.Vehicles``, and the answer an ``Action``. ``prediction`` is
        None without tracker.
        """

    def alternatives(self) -> Mapping[str, Controller]:
        """Return variants of this part, by behaviour such as "brakes earlier". Default: none."""
        return {}

    def counts(self, memory: Any) -> Mapping[str, NDArray[np.int64]]:
        """Return counters (N,) by name, such as a solver's fallbacks. Default: none."""
        return {}

    def plan(self, memory: Any) -> Floats | None:
        """Return the planned motion (N, H + 1, >= 2), x and y first, for pictures. Default: None."""
        return None

    def features(self, memory: Any) -> Floats | None:
        """Return (N, F) numbers as ``System.features`` does. Default: None, some nodes of the plan."""
        return None


class Specification(ABC):
    """Formula over signals with an online monitor whose state is a value.

    Attributes:
        formula: Formula that it monitors (``avrare.logic.formula.Formula``). Default: None.
        names: Vehicles that its quantifiers range over. Default: None, all.
        excluded: Vehicles that it leaves out. Default: none.
        words: Requirement in English, for reports. Default: the formula as an English sentence.
        score: Importance score: "margin", "progress" or "robustness". Default: None, by the formula's shape.
    """

    formula: Any = None
    names: tuple[str, ...] | None = None
    excluded: tuple[str, ...] = ()
    words: str = ""
    score: str | None = None

    @abstractmethod
    def start(self, n: int) -> Any:
        """Return the monitor state of ``n`` particles before sample 0."""

    @abstractmethod
    def update(self, state: Any, signals: Signals) -> tuple[Any, Verdict]:
        """Return the monitor state and the verdict after one more sample."""

    def margin(self, state: Any) -> Floats | None:
        """Return (N,) robustness of φ at the newest sample, of "always φ". Default: None, another shape."""
        return None

    def sample(self, signals: Signals) -> Signals:
        """Return the signals of the formula from those of the system. Default: unchanged."""
        return signals

    def explain(self, signals: Signals) -> str:
        """Return the cause of a violation at sample 0, for the error of a scenario. Default: empty."""
        return ""


class Estimator(ABC, Generic[PlanT, RequestT, RolloutsT, InfoT, ResultT]):
    """Estimator: owns no loop, but asks for rollouts and is given their outcome.

    ``avrare.estimation.plan.plan.Estimator`` names the value types.

    Attributes:
        name: Name in results.
        single: True where it estimates one specification at a time. Default: False.
        needs: Capabilities that a system must have: "branches", "noise". Default: nothing.
        final_scores: True where it reads only the scores of complete rollouts. Default: False.
        stops_early: True where rollouts may end before the last step. Default: False.
        rebuilds_carries: True where it can do without the carries of a stage that is read from a checkpoint.
            Default: False, the stage is run again.
    """

    name: str
    single: bool = False
    needs: tuple[str, ...] = ()
    final_scores: bool = False
    stops_early: bool = False
    rebuilds_carries: bool = False

    @abstractmethod
    def init(self, plan: PlanT) -> tuple[Any, InfoT]:
        """Return the state before the first rollout, and the progress to show; refuse a budget too small."""

    @abstractmethod
    def ask(self, state: Any) -> RequestT | None:
        """Return the next rollouts to run, or None when done; called before each stage."""

    @abstractmethod
    def tell(self, state: Any, rollouts: RolloutsT) -> tuple[Any, InfoT]:
        """Return the state after the rollouts asked for, and the progress to show."""

    @abstractmethod
    def estimate(self, state: Any) -> list[ResultT]:
        """Return one result per specification; called once, after the last stage."""

    def prepare(self, problem: Any) -> Any:
        """Return the problem to estimate; may run rollouts to set itself up. Default: the same problem."""
        return problem

    def estimate_by(self, problem: Any, settings: Any, execute: Any) -> list[ResultT] | None:
        """Return results of other estimators, run by an ``avrare.estimation.plan.plan.Execute``.

        Called before all others. Default: None, it estimates itself.
        """
        return None

    def demand(self, plan: PlanT, carry: int) -> Any:
        """Return the ``avrare.estimation.plan.memory.Demand`` at ``carry`` bytes a carry. Default: None."""
        return None

    def scale(self, rollouts: float, probability: float) -> Any:
        """Return this estimator at a cost of about ``rollouts``, for cross-checks and trials of ``auto``.

        ``probability`` is about that of the failures. Default: None, so few say nothing.
        """
        return None


class Executor(ABC, Generic[WorkT, ChunkT, OutcomeT]):
    """Executor: an ordered map over chunks of rollouts and other calls that it hands to ``run`` of the work.

    ``avrare.rollout.executors.work.Executor`` names the types.

    Attributes:
        workers: Workers among which the rollouts of a request are spread. Default: 1.
        restarts: Number of workers that died and were replaced. Default: 0.
    """

    workers: int = 1
    restarts: int = 0

    @abstractmethod
    def open(self, work: WorkT) -> None:
        """Prepare the workers for chunks of ``work``."""

    @abstractmethod
    def map(self, chunks: Iterable[ChunkT]) -> Iterator[OutcomeT]:
        """Yield outcomes in the order of the chunks; take a chunk no sooner than there is room for it."""

    @abstractmethod
    def close(self) -> None:
        """Stop the workers; called once for each ``open``, after an error too."""
