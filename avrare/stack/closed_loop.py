"""Closed loop: simulator -> perception -> tracker -> controller -> simulator, as one system."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from avrare.driving import Observation
from avrare.protocols import (
    Bools,
    Controller,
    CountsEvents,
    Floats,
    PerceptionErrorModel,
    PersistentPerceptionErrorModel,
    ReportsFaults,
    Signals,
    Simulator,
    Tracker,
    find_ability,
)


@dataclass(frozen=True)
class LoopState:
    """State of the closed loop.

    Attributes:
        world: State of the simulator.
        observation: Newest observation; None at the start and without perception.
        track: State of the tracker, or None.
        memory: State of the controller, or None.
        latent: Memory of a persistent perception error model, or None.
    """

    world: Any
    observation: Observation | None
    track: Any
    memory: Any
    latent: Any = None


class ClosedLoop:
    """System whose noise is the simulator's followed by the perception error model's.

    Each step: predict the others, act, advance the world, observe it, update the track. At t = 0 the tracker
    knows the world exactly. Without perception the tracker observes the true world.

    Args:
        simulator: Simulator.
        perception: Perception error model, or None.
        tracker: Tracker, or None.
        controller: Controller, or None.
    """

    def __init__(
        self,
        simulator: Simulator,
        perception: PerceptionErrorModel | None = None,
        tracker: Tracker | None = None,
        controller: Controller | None = None,
    ) -> None:
        self.simulator = simulator
        self.perception = perception
        self.tracker = tracker
        self.controller = controller
        self._persistent = perception if isinstance(perception, PersistentPerceptionErrorModel) else None
        self.noise_size = simulator.noise_size + (perception.noise_size if perception is not None else 0)

    def initial(self, noise: Floats) -> LoopState:
        """Return the state at t = 0 from noise (N, noise_size)."""
        own = self.simulator.noise_size
        world = self.simulator.reset(noise[:, :own])
        track = self.tracker.start(world) if self.tracker is not None else None
        memory = self.controller.start(len(noise)) if self.controller is not None else None
        latent = self._persistent.start(noise[:, own:]) if self._persistent is not None else None
        return LoopState(world, None, track, memory, latent)

    def step(self, state: LoopState, noise: Floats) -> LoopState:
        """Return the state one step later."""
        action, memory = self._act(state)
        own = self.simulator.noise_size
        world = self.simulator.step(state.world, action, noise[:, :own])
        observation, latent = self._observe(world, noise[:, own:], state.latent)
        track = state.track
        if self.tracker is not None and observation is not None:
            track = self.tracker.update(track, observation)
        return LoopState(world, observation, track, memory, latent)

    def signals(self, state: LoopState) -> Signals:
        """Return the simulator's signals."""
        return self.simulator.signals(state.world)

    def faults(self, state: LoopState) -> Bools:
        """Return (N,) rows that the simulator reports as broken down."""
        simulator = find_ability(self.simulator, ReportsFaults)
        if simulator is None:
            return np.zeros(len(next(iter(self.signals(state).values()))), dtype=bool)
        return np.asarray(simulator.faults(state.world), dtype=bool)

    def counts(self, state: LoopState) -> dict[str, NDArray[np.int64]]:
        """Return counters (N,) of the simulator and of the controller, such as solver fallbacks."""
        found: dict[str, NDArray[np.int64]] = {}
        for part, own in ((self.simulator, state.world), (self.controller, state.memory)):
            counting = find_ability(part, CountsEvents)
            found |= counting.counts(own) if counting is not None else {}
        return found

    def _act(self, state: LoopState) -> tuple[Any, Any]:
        if self.controller is None:
            return None, None
        prediction = None
        if self.tracker is not None:
            prediction = self.tracker.predict(state.track, self.controller.horizon)
        return self.controller.act(state.memory, state.world.ego, prediction)

    def _observe(self, world: Any, noise: Floats, latent: Any) -> tuple[Observation | None, Any]:
        if self._persistent is not None:
            return self._persistent.follow(world, noise, latent)
        if self.perception is not None:
            return self.perception.observe(world, noise), None
        if self.tracker is None:
            return None, None
        others = world.others
        detected = np.ones(others.x.shape, dtype=bool)
        return Observation(detected, others.x, others.y, others.speed * np.cos(others.heading)), None
