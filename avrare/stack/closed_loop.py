"""Closed loop: simulator -> perception -> tracker -> controller -> simulator, as one system.

With weights it is the system of importance sampling over perception error models. Particles are drawn from
the proposal (or from the target) and carry the running sum of
log p_target(observation | world) - log p_proposal(observation | world), the log of their likelihood ratio.
Both densities are evaluated on the same worlds and the same observations, whichever model drew them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from avrare.driving import Observation, Prediction
from avrare.driving.values import extrapolate
from avrare.protocols import (
    Bools,
    Controller,
    Floats,
    Misreading,
    PerceptionErrorModel,
    Signals,
    Simulator,
    System,
    SystemWrapper,
    Tracker,
    adapt,
)
from avrare.stack.burn_in import BurnIn
from avrare.stack.drawn_start import DrawnStart, DrawnValues
from avrare.stack.features import check_features, flatten, plan_features, track_features, vehicle_features
from avrare.stack.observation import find_misreadings, observe
from avrare.stack.part_checks import find_noise_names, find_perfect_noise
from avrare.stack.timed_controller import TimedController


@dataclass(frozen=True)
class LoopState:
    """State of the closed loop.

    Attributes:
        world: State of the simulator.
        observation: Newest observation; None at a start without burn-in, and without perception and tracker.
        track: State of the tracker, or None.
        memory: State of the controller, or None.
        latent: Memory of a persistent perception error model, or None.
        drawn: Values drawn at the start, or None.
    """

    world: Any
    observation: Observation | None
    track: Any
    memory: Any
    latent: Any = None
    drawn: DrawnValues | None = None


class ClosedLoop(System):
    """System whose noise is that of drawn options, if any, the simulator's and the perception error model's.

    Each step: predict the others, act, advance the world, observe it, update the track. Nothing is
    observed at t = 0 and before, but by a tracker that burns in. Without perception the tracker observes the
    true world.

    Args:
        simulator: The world.
        perception: Perception error model, if there is one.
        tracker: Tracker, if there is one.
        controller: Controller, if there is one.
        start: Draws of the simulator's options, if there are any.
        burn_in: Observations of the tracker before the start; None: what it asks for.
    """

    def __init__(
        self,
        simulator: Simulator,
        perception: PerceptionErrorModel | None = None,
        tracker: Tracker | None = None,
        controller: Controller | None = None,
        start: DrawnStart | None = None,
        burn_in: BurnIn | None = None,
    ) -> None:
        self.simulator = simulator = adapt(Simulator, simulator)
        self.start = start
        self.perception = None if perception is None else adapt(PerceptionErrorModel, perception)
        self.tracker = None if tracker is None else adapt(Tracker, tracker)
        self.controller = None if controller is None else adapt(Controller, controller)
        self.dt, self.scene = simulator.dt, simulator.scene
        self.lacks, self.warnings = simulator.lacks, dict(simulator.warnings)
        if burn_in is None and self.tracker is not None and self.tracker.burn_in:
            burn_in = BurnIn(self.tracker, self.perception, self.tracker.burn_in, simulator.dt)
        self.burn_in = burn_in
        self._drawn = start.size if start is not None else 0
        self.world_noise = self._drawn + simulator.noise_size
        names = start.noise_names if start is not None else ()
        names += find_noise_names(simulator, "simulator noise")
        perfect = [np.zeros(self._drawn), find_perfect_noise(simulator)]
        if self.perception is not None:
            names += find_noise_names(self.perception, "perception noise")
            perfect.append(find_perfect_noise(self.perception))
            self.warnings |= self.perception.warnings
        self._seen = slice(self.world_noise, len(names))
        self._timed = controller if isinstance(controller, TimedController) else None
        if self._timed is not None:
            names += self._timed.noise_names
            perfect.append(np.zeros(len(self._timed.noise_names)))
        self.noise_names, self.perfect_noise = names, np.concatenate(perfect)
        self.noise_size = len(names)

    def controlled_by(self, controller: Controller) -> ClosedLoop:
        """Return the same loop with another controller."""
        parts = self.simulator, self.perception, self.tracker, controller
        return ClosedLoop(*parts, self.start, self.burn_in)

    def check_steps(self, steps: int) -> None:
        """Raise a ``UsageError`` if the simulator does not support this number of steps."""
        self.simulator.check_steps(steps)

    def initial(self, noise: Floats) -> LoopState:
        """Return the state at t = 0 from noise (N, noise_size)."""
        world_size, drawn = self.world_noise, None
        if self.start is not None:
            world, drawn = self.start.reset(noise[:, :world_size])
        else:
            world = self.simulator.reset(noise[:, :world_size])
        memory = self.controller.start(len(noise)) if self.controller is not None else None
        if self.burn_in is not None:
            observation, track, latent = self.burn_in.run(world, noise[:, world_size:])
            return LoopState(world, observation, track, memory, latent, drawn)
        track = self.tracker.start(world) if self.tracker is not None else None
        latent = self.perception.start(noise[:, self._seen]) if self.perception is not None else None
        return LoopState(world, None, track, memory, latent, drawn)

    def step(self, state: LoopState, noise: Floats) -> LoopState:
        """Return the state one step later."""
        action, memory = self.act(state, noise)
        world = self.simulator.step(state.world, action, noise[:, self._drawn : self.world_noise])
        observation, latent, track = None, None, state.track
        if self.perception is not None or self.tracker is not None:
            observation, latent = observe(self.perception, world, noise[:, self._seen], state.latent)
            track = self.tracker.update(track, observation) if self.tracker is not None else None
        return LoopState(world, observation, track, memory, latent, state.drawn)

    def predict(self, state: LoopState) -> Prediction | None:
        """Return the others over the controller's horizon, as the tracker predicts them; None without one.

        A controller that sees the truth gets their true positions, at their present velocities.
        """
        if self.controller is not None and self.controller.sees_truth:
            return extrapolate(state.world.others, self.controller.horizon, self.simulator.dt)
        if self.tracker is None or self.controller is None:
            return None
        return self.tracker.predict(state.track, self.controller.horizon)

    def show(self, world: Any) -> Any:
        """Return the view of a controller on a world: its ``ego``, else its signals (N, d)."""
        return world.ego if hasattr(world, "ego") else flatten(self.simulator.signals(world))

    def act(self, state: LoopState, noise: Floats | None = None) -> tuple[object, object]:
        """Return the action of the next step and the controller's memory after it, None without one."""
        if self.controller is None:
            return None, None
        ego = self.show(state.world)
        if self.perception is not None:
            ego = self.perception.locate(ego, state.latent)
        if self._timed is not None and noise is not None:
            return self._timed.act(state.memory, ego, self.predict(state), noise[:, self._seen.stop :])
        return self.controller.act(state.memory, ego, self.predict(state))

    def signals(self, state: LoopState) -> Signals:
        """Return the simulator's signals, and the drawn values."""
        signals = self.simulator.signals(state.world)
        if self.start is None or state.drawn is None:
            return signals
        return {**signals, **self.start.signals(state.drawn)}

    def faults(self, state: LoopState) -> Bools:
        """Return (N,) rows that the simulator reports as broken down, or whose scene is impossible."""
        broken = self.simulator.faults(state.world)
        if broken is None:
            broken = np.zeros(len(next(iter(self.signals(state).values()))), dtype=bool)
        broken = np.asarray(broken, dtype=bool)
        return broken if state.drawn is None else broken | state.drawn.refused

    def ended(self, state: LoopState) -> Bools | None:
        """Return a mask (N,) of the drives that the simulator has ended; None if it ends none."""
        return self.simulator.ended(state.world)

    def counts(self, state: LoopState) -> dict[str, NDArray[np.int64]]:
        """Return counters (N,) of draws, simulator and controller, such as solver fallbacks."""
        drawn = {} if state.drawn is None else {"scenes_redrawn": state.drawn.redraws}
        planned = {} if self.controller is None else self.controller.counts(state.memory)
        return {**drawn, **self.simulator.counts(state.world), **planned}

    def misreadings(self, state: LoopState) -> dict[str, Misreading]:
        """Return the errors that the simulator declares, and those of the perceived vehicles."""
        misreadings = dict(self.simulator.misreadings(state.world))
        if self.perception is not None and self.scene is not None and state.observation is not None:
            misreadings |= find_misreadings(self.perception, state.world, state.observation, self.scene)
        return misreadings

    def features(self, state: LoopState) -> Floats:
        """Return the features (N, F) that the parts declare, or else those of every driving stack."""
        driving = hasattr(state.world, "ego") and hasattr(state.world, "others")
        parts = [_read_features(self.simulator, state.world)]
        if parts[0] is None:
            parts = [flatten(self.signals(state)), vehicle_features(state.world) if driving else None]
        parts.append(_read_features(self.perception, state.latent))
        tracked = _read_features(self.tracker, state.track)
        if tracked is None and self.tracker is not None and driving:
            tracked = track_features(self.tracker, state.track, state.world)
        planned = _read_features(self.controller, state.memory)
        if planned is None and self.controller is not None:
            planned = plan_features(self.controller.plan(state.memory))
        parts += [tracked, planned]
        return np.concatenate([part for part in parts if part is not None], axis=1)


def _read_features(part: Any, state: Any) -> Floats | None:
    declared = part.features(state) if state is not None else None
    return None if declared is None else check_features(part, declared)


@dataclass(frozen=True)
class SamplingLaw:
    """Distribution that the rows of a request are drawn from (``Request.law``).

    Attributes:
        proposal: Perception error model, or a recipe for one: an object with ``for_target(perception)``,
            which returns it; None: the problem's own.
        from_target: Draw from the target instead, and weigh against the proposal all the same.
    """

    proposal: Any = None
    from_target: bool = False


@dataclass(frozen=True)
class WeightedLoopState:
    """State of the closed loop and its weight.

    Attributes:
        loop: World, observation, track and memory.
        log_weight: (N,) log of the likelihood ratio of all observations so far.
    """

    loop: LoopState
    log_weight: Floats


class WeightedLoop(SystemWrapper):
    """Closed loop under a proposal; without ``under`` it is the target itself.

    Args:
        target: Closed loop whose perception error model has ``log_prob``.
        proposal: Perception error model to draw from, or None where each request brings its own.
        law: Distribution to draw from; None: the target, unweighted.
    """

    def __init__(self, target: ClosedLoop, proposal: Any = None, law: SamplingLaw | None = None) -> None:
        super().__init__(target)
        self.target, self.proposal, self.law = target, proposal, law
        self._density = self._proposal_density(law)
        self._drawn = target
        if law is not None and not law.from_target:
            self._drawn = ClosedLoop(
                target.simulator,
                self._density,
                target.tracker,
                target.controller,
                target.start,
                target.burn_in,
            )
        world_size = target.world_noise
        self.noise_size = max(
            target.noise_size, world_size + (proposal.noise_size if proposal is not None else 0)
        )
        self.noise_names = self.perfect_noise = None  # those of the target, or of the proposal

    def _proposal_density(self, law: SamplingLaw | None) -> Any:
        if law is None:
            return None
        proposal = law.proposal if law.proposal is not None else self.proposal
        return proposal.for_target(self.target.perception) if hasattr(proposal, "for_target") else proposal

    def under(self, law: SamplingLaw) -> WeightedLoop:
        """Return the same loop drawn from ``law``."""
        return WeightedLoop(self.target, self.proposal, law)

    def initial(self, noise: Floats) -> WeightedLoopState:
        """Return the state at t = 0 from noise (N, noise_size)."""
        return WeightedLoopState(self._drawn.initial(noise), np.zeros(len(noise)))

    def step(self, state: WeightedLoopState, noise: Floats) -> WeightedLoopState:
        """Return the state one step later."""
        loop = self._drawn.step(state.loop, self._take_loop_noise(noise))
        if self._density is None:
            return replace(state, loop=loop)
        target: Any = self.target.perception
        log_target, log_drawn = (
            model.log_prob(loop.world, loop.observation) for model in (target, self._density)
        )
        return WeightedLoopState(loop, state.log_weight + (log_target - log_drawn))

    def unwrap(self, state: WeightedLoopState) -> LoopState:
        """Return the state of the loop without its weight."""
        return state.loop

    def faults(self, state: WeightedLoopState) -> Bools:
        """Return (N,) rows that broke down, or whose observation has density 0 under both models."""
        return np.asarray(self.target.faults(state.loop) | np.isnan(state.log_weight))

    def log_weights(self, state: WeightedLoopState) -> Floats:
        """Return (N,) log of the likelihood ratio."""
        return state.log_weight

    def _take_loop_noise(self, noise: Floats) -> Floats:
        # Models may need different many numbers.
        return noise[:, : self._drawn.noise_size]
