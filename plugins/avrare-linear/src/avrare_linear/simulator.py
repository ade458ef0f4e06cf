"""Simulator ``linear``."""

from __future__ import annotations

from avrare.base.errors import UsageError
from avrare.protocols import Floats, Signals, Simulator
from avrare.rollout.problem import Problem
from avrare.stack.closed_loop import ClosedLoop
from avrare_linear.config import LinearConfig
from avrare_linear.system import LinearState, LinearSystem


def build(config: LinearConfig, scene: object | None = None) -> LinearSimulator:
    """Build the simulator of a scenario."""
    return LinearSimulator(config)


class LinearSimulator(Simulator):
    """Linear system with its own controller.

    Attributes:
        dt: Step [s].
        noise_size: Number of states and outputs.
        system: System that is simulated.
    """

    def __init__(self, config: LinearConfig) -> None:
        self.system = from_config(config)
        self.dt = config.dt
        self.noise_size = self.system.noise_size
        self.noise_names = self.system.noise_names

    def reset(self, noise: Floats) -> LinearState:
        """Return the state at t = 0."""
        return self.system.initial(noise)

    def step(self, world: LinearState, action: object, noise: Floats) -> LinearState:
        """Return the state one step later.

        Raises:
            UsageError: The scenario has a controller.
        """
        if action is not None:
            raise UsageError(
                "the simulator linear has a controller of its own",
                "use `feedback:` in place of `controller:`",
            )
        return self.system.step(world, noise)

    def signals(self, world: LinearState) -> Signals:
        """Return the signals of the system."""
        return self.system.signals(world)


def from_config(config: LinearConfig) -> LinearSystem:
    """Build the system of a scenario.

    Raises:
        UsageError: A covariance is invalid, or an optimal gain does not exist.
    """
    feedback, observer = config.feedback, config.observer
    costs = None
    if feedback is not None and feedback.state_cost is not None and feedback.input_cost is not None:
        costs = feedback.state_cost[0], feedback.input_cost[0]
    gain = observer.gain if observer is not None else None
    return LinearSystem.of(
        config.states,
        config.A,
        config.initial.mean,
        covariance=config.initial.covariance,
        inputs=config.inputs,
        B=config.B,
        outputs=config.outputs,
        C=config.C,
        process_noise=config.process_noise,
        measurement_noise=config.measurement_noise,
        gain=feedback.gain if feedback is not None else None,
        costs=costs,
        observer=gain if gain is not None else observer is not None,
        reference=config.reference,
        feedforward=config.feedforward,
    )


def system_of(problem: Problem) -> LinearSystem:
    """Return the linear system of a problem.

    Raises:
        UsageError: The problem has another system.
    """
    system: object = problem.system
    if isinstance(system, ClosedLoop) and isinstance(system.simulator, LinearSimulator):
        system = system.simulator.system
    if not isinstance(system, LinearSystem):
        raise UsageError("the system is not linear", "use `simulator: {plugin: linear, ...}`")
    return system
