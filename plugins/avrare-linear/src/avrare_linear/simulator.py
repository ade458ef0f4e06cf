"""The linear system as a simulator of scenarios."""

from __future__ import annotations

from typing import Any

from avrare.errors import UsageError
from avrare.protocols import Floats, Signals
from avrare.rollout.problem import Problem
from avrare_linear.config import LinearConfig
from avrare_linear.system import LinearState, LinearSystem


def build(config: LinearConfig, scene: object | None = None) -> LinearSimulator:
    """The simulator of a scenario."""
    return LinearSimulator(config)


class LinearSimulator:
    """A linear system that brings its own controller.

    Attributes:
        dt: Step [s].
        noise_size: States and outputs together.
        system: The system itself.
    """

    def __init__(self, config: LinearConfig) -> None:
        self.system = from_config(config)
        self.dt = config.dt
        self.noise_size = self.system.noise_size

    def reset(self, noise: Floats) -> LinearState:
        """State at t = 0."""
        return self.system.initial(noise)

    def step(self, world: LinearState, action: Any, noise: Floats) -> LinearState:
        """State one step later.

        Raises:
            UsageError: The scenario has a controller.
        """
        if action is not None:
            raise UsageError("linear has a controller of its own", "leave out `controller:`, use `feedback:`")
        return self.system.step(world, noise)

    def signals(self, world: LinearState) -> Signals:
        """The system's."""
        return self.system.signals(world)


def from_config(config: LinearConfig) -> LinearSystem:
    """The system that a scenario describes.

    Raises:
        UsageError: A covariance is none, or there is no optimal gain.
    """
    feedback, observer = config.feedback, config.observer
    costs = None
    if feedback is not None and feedback.state_cost is not None and feedback.input_cost is not None:
        costs = feedback.state_cost[0], feedback.input_cost[0]
    given = observer.gain if observer is not None else None
    return LinearSystem.of(
        config.states, config.A, config.initial.mean, covariance=config.initial.covariance,
        inputs=config.inputs, B=config.B, outputs=config.outputs, C=config.C,
        process_noise=config.process_noise, measurement_noise=config.measurement_noise,
        gain=feedback.gain if feedback is not None else None, costs=costs,
        observer=given if given is not None else observer is not None,
        reference=config.reference, feedforward=config.feedforward,
    )  # fmt: skip


def system_of(problem: Problem) -> LinearSystem:
    """The linear system of a scenario's problem, or the problem's own.

    Raises:
        UsageError: Its simulator is another one.
    """
    loop: Any = problem.system
    simulator = getattr(loop, "simulator", None)
    system = simulator.system if isinstance(simulator, LinearSimulator) else loop
    if not isinstance(system, LinearSystem):
        raise UsageError("the system is not linear", "use `simulator: {plugin: linear, ...}`")
    return system
