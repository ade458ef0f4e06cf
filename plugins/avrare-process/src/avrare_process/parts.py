"""Simulator and controller in a program, N worlds a message."""

from __future__ import annotations

from functools import partial
from typing import cast

import numpy as np
from numpy.typing import NDArray

from avrare.base import batch
from avrare.base.errors import UsageError
from avrare.protocols import Controller, Floats, Signals, Simulator
from avrare.worlds import WorldController, WorldState
from avrare.worlds.step_timeout import Watchdog
from avrare.worlds.world import Table
from avrare.worlds.world_histories import Branches, InputHistory, WorldPool
from avrare_process.config import ProcessConfig
from avrare_process.process import ProcessEnded
from avrare_process.worlds import Client, RemoteWorld, move


def build_simulator(config: ProcessConfig, scene: object | None = None) -> ProcessSimulator:
    """Build the simulator of a scenario."""
    return ProcessSimulator(config)


def build_controller(config: ProcessConfig, scene: object | None = None) -> Controller:
    """Build the controller of a scenario."""
    worlds = ProcessSimulator(config, "controller")
    return WorldController(worlds) if worlds.client.hello.memory else ProcessFunction(config)


class ProcessSimulator(Simulator):
    """Simulator in a program, of which each process has its own.

    A row that branches continues from a copy in the program where it can copy; else, and after the program
    has ended, its inputs are replayed.

    Args:
        config: Options of a scenario.
        role: "simulator" or "controller".
    """

    def __init__(self, config: ProcessConfig, role: str = "simulator") -> None:
        self._arguments = config, role
        self.client = Client(config, role)
        hello = self.client.hello
        self.dt, self.noise_size, self.noise_names = hello.dt, len(hello.noise), hello.noise or None
        self._pool = WorldPool(partial(RemoteWorld, self.client), "hook" if hello.copy_ else "replay", True)
        self._readout = Table(RemoteWorld(self.client))
        self._branches = Branches(self._pool, Watchdog(None), self._readout)

    def __reduce__(self) -> tuple[object, ...]:
        return type(self), self._arguments

    def reset(self, noise: Floats) -> WorldState:
        """Return worlds at t = 0 from noise (N, noise_size)."""
        self._pool.recall(len(noise), keep=())
        histories = [InputHistory([row], []) for row in noise.copy()]
        worlds = [cast("RemoteWorld", self._pool.take_world(history)) for history in histories]
        try:
            move(worlds, "reset", noise=noise.tolist())
        except ProcessEnded:  # it is started again
            move(worlds, "reset", noise=noise.tolist())
        zeros = np.zeros(len(noise), dtype=np.int64)
        return self._read(zeros, histories, zeros)

    def step(self, world: WorldState, action: object, noise: Floats) -> WorldState:
        """Return worlds one step later; ``action`` is an array with leading axis N, or None."""
        if action is not None and np.ndim(cast("Floats", action)) != 2:
            raise UsageError(
                f"a program takes numbers (N, d), not {type(action).__name__}",
                "a controller that returns an array with a row for each rollout",
            )
        inputs = None if action is None else np.array(action, dtype=np.float64)
        try:
            return self._advance(world, inputs, noise.copy())
        except ProcessEnded:  # it is started again, and the worlds are replayed
            return self._advance(world, inputs, noise.copy())

    def signals(self, world: WorldState) -> Signals:
        """Return the signals of the worlds, (N,) each."""
        return world.signals

    def counts(self, world: WorldState) -> dict[str, NDArray[np.int64]]:
        """Return ``replayed_steps`` (N,), where the program cannot copy."""
        return {"replayed_steps": world.replayed} if self._pool.copying == "replay" else {}

    def _advance(self, world: WorldState, inputs: Floats | None, noise: Floats) -> WorldState:
        histories, replayed = self._place(world)
        rows = [None] * len(histories) if inputs is None else list(inputs)
        worlds = [cast("RemoteWorld", history.world) for history in histories]
        sent = None if inputs is None else inputs.tolist()
        move(worlds, "step", inputs=sent, noise=noise.tolist())
        for history, place, row, numbers in zip(histories, worlds, rows, noise, strict=True):
            t = len(history.actions)
            history.actions.append(row)
            history.noise.append(numbers)
            history.latest = place.outputs
            if self._branches.untested and t in history.copies:
                self._branches.test_copy(history, t, (row, numbers))
        return self._read(world.step + 1, histories, replayed)

    def _place(self, state: WorldState) -> tuple[list[InputHistory], NDArray[np.int64]]:
        """Return histories that end at the rows' steps with a world of their own, and the steps replayed."""
        histories, replayed = state.track.tolist(), state.replayed.copy()
        at = state.step.tolist()
        ready = {
            history
            for history, t in zip(histories, at, strict=True)
            if history.world is not None and history.world.alive and len(history.actions) == t
        }
        if len(ready) < len(histories):
            self._pool.recall(len(histories) - len(ready), set(ready))
        for i, (history, t) in enumerate(zip(histories, at, strict=True)):
            if history in ready:
                ready.remove(history)  # a second row with it gets a world of its own
                continue
            history.copies = {step: copy for step, copy in history.copies.items() if copy.alive}
            replayed[i] += t
            signals = batch.take(state.signals, slice(i, i + 1))
            histories[i] = self._branches.branch(history, t, signals)
        return histories, replayed

    def _read(
        self, step: NDArray[np.int64], histories: list[InputHistory], replayed: NDArray[np.int64]
    ) -> WorldState:
        column = np.empty(len(histories), dtype=object)
        column[:] = histories
        worlds = [cast("RemoteWorld", history.world) for history in histories]
        return WorldState(step, column, *self._readout.stack([world.outputs for world in worlds]), replayed)


class ProcessFunction(Controller):
    """Controller without memory in a program.

    Args:
        config: Options of a scenario.
    """

    def __init__(self, config: ProcessConfig) -> None:
        self._config, self._client = config, Client(config, "controller")

    def __reduce__(self) -> tuple[object, ...]:
        return type(self), (self._config,)

    def act(self, memory: None, ego: Floats, prediction: object) -> tuple[Floats, None]:
        """Return the actions (N, d)."""
        rows = {"inputs": np.asarray(ego, dtype=np.float64).tolist(), "noise": [[]] * len(ego)}
        try:
            actions = self._client.move("step", list(range(len(ego))), **rows)
        except ProcessEnded:  # it is started again
            actions = self._client.move("step", list(range(len(ego))), **rows)
        return np.array(actions, dtype=np.float64), None
