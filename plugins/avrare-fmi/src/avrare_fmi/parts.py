"""Simulator and controller of an FMU: an instance for each rollout of a chunk."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from avrare.base.errors import UsageError
from avrare.protocols import Controller, Floats
from avrare.worlds import World, WorldController, Worlds
from avrare_fmi.config import FmuConfig, SimulatorConfig
from avrare_fmi.model import Instance, Model, State

_models: dict[str, Model] = {}


def build_simulator(config: SimulatorConfig, scene: object | None = None) -> Worlds:
    """Build the simulator of a scenario."""
    return _build_worlds(config)


def build_controller(config: FmuConfig, scene: object | None = None) -> Controller:
    """Build the controller of a scenario."""
    return WorldController(_build_worlds(config))


def _build_worlds(config: FmuConfig) -> Worlds:
    model = _open(config.file)
    if config.copy_by == "state" and not model.can_copy:
        raise UsageError(f"{config.file}: canGetAndSetFMUstate is not set", "copy: replay")
    copies = config.copy_by != "replay" and model.can_copy
    return Worlds(partial(FmuWorld, config), dt=config.dt, copy="hook" if copies else "replay")


def _open(file: str) -> Model:
    if file not in _models:  # its library is loaded once
        _models[file] = Model(file)
    return _models[file]


class FmuWorld(World):
    """Instance of an FMU; an action goes into its inputs, and scaled noise into those that take it.

    Args:
        config: Options of a scenario.
    """

    has_table = True

    def __init__(self, config: FmuConfig) -> None:
        self.config, self.model = config, _open(config.file)
        noise = config.noise if isinstance(config, SimulatorConfig) else {}
        seen = config.seen if isinstance(config, SimulatorConfig) else ()
        self.noise_size, self.noise_names = len(noise), tuple(noise) or None
        self._scales = np.array(list(noise.values()), dtype=np.float64)
        self._inputs, self._noise = self.model.find(config.inputs), self.model.find(noise)
        self._outputs = self.model.find((*config.outputs, *seen))
        self._start = self.model.find(config.start)
        self._instance: Instance | None = None
        self._time = 0

    def reset(self, noise: Floats) -> None:
        """Reset to t = 0 in a new instance: not every FMU forgets all in a reset."""
        self._instance = None  # freed before, where only one is allowed
        self._instance = instance = self.model.instantiate()
        self._start.set(instance, list(self.config.start.values()))
        instance.enter_initialisation()
        self._start.set(instance, list(self.config.start.values()))
        self._noise.set(instance, (self._scales * noise).tolist())
        instance.fmu.exitInitializationMode()
        self._time = 0

    def prepare(self, actions: Any, noise: Floats) -> Any:
        """Check and return the actions (N, d).

        Raises:
            UsageError: They do not fit the inputs.
        """
        expected_shape = (len(noise), len(self.config.inputs)) if self.config.inputs else ()
        if np.shape(actions) != expected_shape:
            shape = np.shape(actions) or f"of {type(actions).__name__}"
            raise UsageError(
                f"{self.config.file}: inputs {', '.join(self.config.inputs) or '(none)'} get values {shape}",
                f"`inputs` has a name for each, in the order of the array {expected_shape}",
            )
        return actions

    def step(self, action: Floats | None, noise: Floats) -> None:
        """Advance by a step."""
        instance = self._running()
        if action is not None:
            self._inputs.set(instance, action.tolist())
        if self.noise_size:
            self._noise.set(instance, (self._scales * noise).tolist())
        instance.fmu.doStep(self._time * self.config.dt, self.config.dt, False)
        self._time += 1

    def numbers(self) -> list[float]:
        """Return the outputs, then what the controller sees."""
        return self._outputs.get(self._running())

    def split_table(self, table: Floats) -> tuple[dict[str, Floats], Floats]:
        """Split numbers (N, K) into signals and observations."""
        names = self.config.outputs
        observed = table[:, len(names) :] if table.shape[1] > len(names) else table
        return dict(zip(names, table.T.copy(), strict=False)), observed.copy()

    def signals(self) -> dict[str, float]:
        """Return the outputs."""
        return dict(zip(self.config.outputs, self.numbers(), strict=False))

    def snapshot(self) -> tuple[State, int]:
        """Return the FMU's state, and the number of steps."""
        return State(self._running(), self.model.can_serialise), self._time

    def restore(self, snapshot: tuple[State, int]) -> None:
        """Continue from a snapshot."""
        if self._instance is None:
            self.reset(np.zeros(self.noise_size))
        state, self._time = snapshot
        state.restore(self._running())

    def close(self) -> None:
        """Free the instance."""
        self._instance = None

    def _running(self) -> Instance:
        if self._instance is None:
            raise UsageError("the FMU has not been reset", "call reset() before step()")
        return self._instance
