"""Plans as arrays: memory of a particle, interface of the solver backends, initial guesses."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from avrare.base.errors import UsageError
from avrare.driving import Scene, Vehicles
from avrare.protocols import Bools, Floats
from avrare_mpc.config import MpcConfig

Integers = NDArray[np.int64]

STATES = 5
"""Number of states of a stage: x, y, speed, heading, turn rate of the previous step."""
STAGE = 8
"""Number of variables of a stage: the states, acceleration, turn rate, lateral slack."""


@dataclass(frozen=True)
class Memory:
    """Last plan and counters of N particles.

    Attributes:
        plan_states: (N, H + 1, 4) x, y, speed, heading; entry 0 is the state of the last action.
        plan_inputs: (N, H, 2) acceleration, turn rate; entry 0 was the last action.
        solved: (N,) whether there is a plan; False at the start and once failures have used up the plan.
        age: (N,) steps since the plan was found.
        solves: (N,) solver calls, several at the first step.
        retries: (N,) solver calls whose first attempt failed.
        fallbacks: (N,) steps without a new plan, on the old one or braking.
        start_policy: (N,) index of the initial guess that gave the first plan; -1 before there is one.
    """

    plan_states: Floats
    plan_inputs: Floats
    solved: Bools
    age: Integers
    solves: Integers
    retries: Integers
    fallbacks: Integers
    start_policy: Integers


@dataclass(frozen=True)
class SearchResult:
    """Plans of N particles; meaningless where not ``feasible``.

    Attributes:
        states: (N, H + 1, 4) x, y, speed, heading.
        inputs: (N, H, 2) acceleration, turn rate.
        feasible: (N,) whether there is a plan.
        solves: (N,) solver calls.
        retries: (N,) solver calls whose first attempt failed.
        chosen: (N,) index of the guess that gave the plan; -1 where there is none.
    """

    states: Floats
    inputs: Floats
    feasible: Bools
    solves: Integers
    retries: Integers
    chosen: Integers


class Search(Protocol):
    """Backend that finds plans of N particles; a row's plan does not depend on the other rows."""

    def __call__(
        self, solved: Bools, start: Floats, old: tuple[Floats, Floats], others: tuple[Floats, Floats]
    ) -> SearchResult:
        """Return the cheapest plan of each particle.

        Args:
            solved: (N,) True: search from the old plan; False: from the initial guesses.
            start: (N, 5) x, y, speed, heading now, and the last turn rate.
            old: States (N, H + 1, 4) and inputs (N, H, 2) of the old plans, one step on.
            others: Predicted x and y, each (N, V, H + 1) [m].
        """
        ...


def start_of(ego: Vehicles, turn_rate: Floats | float = 0.0) -> Floats:
    """Return the states (N, 5) at which plans start: x, y, speed, heading and the last turn rate."""
    return np.stack([ego.x, ego.y, ego.speed, ego.heading, np.broadcast_to(turn_rate, ego.x.shape)], axis=1)


def shift(states: Floats, inputs: Floats, dt: float) -> tuple[Floats, Floats]:
    """Shift plans by one step; the last state moves on at constant speed and heading."""
    x, y, speed, heading = np.moveaxis(states[:, -1:], -1, 0)
    last = [x + dt * speed * np.cos(heading), y + dt * speed * np.sin(heading), speed, heading]
    later_states = np.concatenate([states[:, 1:], np.stack(last, axis=-1)], axis=1)
    later_inputs = np.concatenate([inputs[:, 1:], np.zeros_like(inputs[:, :1])], axis=1)
    return later_states, later_inputs


def to_variables(states: Floats, inputs: Floats) -> Floats:
    """Convert plans (..., H + 1, 4) and (..., H, 2) to the programme's variables (..., 8 H + 5)."""
    stages = np.zeros((*states.shape[:-1], STAGE))
    stages[..., :4] = states
    stages[..., 1:, 4] = inputs[..., 1]
    stages[..., :-1, STATES : STATES + 2] = inputs
    flat = stages.reshape(*states.shape[:-2], states.shape[-2] * STAGE)
    return flat[..., : STATES - STAGE]


def from_variables(variables: Floats) -> tuple[Floats, Floats]:
    """Convert the programme's variables (N, 8 H + 5) to plans (N, H + 1, 4) and (N, H, 2)."""
    padded = np.concatenate([variables, np.zeros((len(variables), STAGE - STATES))], axis=1)
    stages = padded.reshape(len(variables), -1, STAGE)
    return stages[:, :, :4].copy(), stages[:, :-1, STATES : STATES + 2].copy()


def initial_guesses(
    start: Floats, centres: tuple[float, ...], steps: int, dt: float
) -> tuple[Floats, Floats]:
    """Return states and inputs of the guesses from which the first plan is searched, two for each lane.

    The programme has several local minima (stay behind, change lane), and a solver finds one near its guess.
    The guesses are solved in this order, and the cheapest plan counts: first lane at constant speed, first
    lane braking, second lane at constant speed, and so on. Later steps follow the chosen minimum by starting
    from the last plan.

    Args:
        start: (N, 5) x, y, speed, heading now, and the last turn rate, which does not matter.
        centres: y of the C lanes [m].
        steps: H.
        dt: Step [s].

    Returns:
        (N, 2 C, H + 1, 4) x, y, speed, heading and (N, 2 C, H, 2) acceleration, turn rate. They are smooth,
        but not exact solutions of the model.
    """
    x, y, speed, heading = _guess_motion(start, centres, steps, dt)
    states = np.stack(np.broadcast_arrays(x[:, None], y[:, :, None], speed[:, None], heading), axis=-1)
    inputs = _guess_inputs(speed, heading, dt)
    return states.reshape(inputs.shape[:2] + states.shape[3:]), inputs


def initial_inputs(start: Floats, centres: tuple[float, ...], steps: int, dt: float) -> Floats:
    """Return the inputs of ``initial_guesses``, without their states."""
    _, _, speed, heading = _guess_motion(start, centres, steps, dt)
    return _guess_inputs(speed, heading, dt)


def _guess_motion(
    start: Floats, centres: tuple[float, ...], steps: int, dt: float
) -> tuple[Floats, Floats, Floats, Floats]:
    decelerations = (0.0, 3.0)  # [m/s^2]
    # x and speed (N, B, H + 1) differ by braking, y (N, C, H + 1) by lane, heading (N, C, B, H + 1) by both
    braking, lanes, time = (
        np.array(decelerations)[:, None],
        np.array(centres)[:, None],
        np.arange(steps + 1) * dt,
    )
    x0, y0, v0, h0 = (start[:, i, None, None] for i in range(4))
    speed = np.where(v0 > 0.0, np.maximum(v0 - braking * time, 0.0), v0)
    # a guess reaches its lane after three quarters of the horizon
    part = np.clip(time / (0.75 * steps * dt), 0.0, 1.0)
    y = y0 + (lanes - y0) * part**2 * (3.0 - 2.0 * part)
    x = np.broadcast_to(x0, speed.shape).copy()
    x[..., 1:] += np.cumsum(speed[..., :-1] * dt, axis=-1)
    heading = np.zeros((len(start), len(centres), len(decelerations), steps + 1))
    np.arctan2(np.diff(y)[:, :, None], np.maximum(np.diff(x), dt)[:, None], out=heading[..., :-1])
    heading[..., 0] = h0
    return x, y, speed, heading


def _guess_inputs(speed: Floats, heading: Floats, dt: float) -> Floats:
    n, lanes, braking, nodes = heading.shape
    inputs = np.empty((n, lanes, braking, nodes - 1, 2))
    inputs[..., 0] = (np.diff(speed) / dt)[:, None]
    inputs[..., 1] = np.diff(heading) / dt
    return inputs.reshape(n, lanes * braking, nodes - 1, 2)


def cheapest(cost: Floats) -> Integers:
    """Return the index of the first least cost (N, G), up to ties; -1 where all costs are infinite."""
    best = np.full(len(cost), np.inf)
    chosen = np.full(len(cost), -1, dtype=np.int64)
    for index, candidate in enumerate(cost.T):
        # plans whose costs differ by less, relatively, are the same minimum: the first one counts
        tie = 1e-6
        margin = np.where(chosen >= 0, tie * np.abs(np.where(chosen >= 0, best, 0.0)), 0.0)
        better = candidate < best - margin
        best = np.where(better, candidate, best)
        chosen = np.where(better, index, chosen)
    return chosen


def lane_centres(config: MpcConfig, scene: Scene) -> tuple[float, ...]:
    """Return the lateral positions of the lanes that the ego may use [m].

    Raises:
        UsageError: The road has no such lane.
    """
    centres = scene.road.lane_centres
    if max(config.lanes) >= len(centres):
        raise UsageError(f"lanes: there is no lane {max(config.lanes)}, the road has {len(centres)} lanes")
    return tuple(centres[lane] for lane in config.lanes)


def lateral_bounds(config: MpcConfig, scene: Scene) -> tuple[float, float]:
    """Return the bounds of the ego's centre that keep its sides ``y_margin`` inside its lanes [m]."""
    centres = lane_centres(config, scene)
    room = (scene.road.lane_width - scene.ego_width) / 2 - config.y_margin
    return min(centres) - room, max(centres) + room
