"""Lane-change model-predictive controller: one programme for each particle and step."""

from __future__ import annotations

import functools
import multiprocessing
import warnings
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from avrare.base.errors import UsageError
from avrare.driving import Action, Prediction, Scene, Vehicles
from avrare.driving.reference_line import ReferenceLine
from avrare.protocols import Bools, Controller, Floats
from avrare_mpc.bends import BendSpeed, measure_along_ego_offset, road_slip_angle, road_yaw_rate
from avrare_mpc.config import MpcConfig
from avrare_mpc.lane_gaps import find_gaps
from avrare_mpc.plan import Memory, Search, lane_centres, shift, start_of
from avrare_mpc.stopping import stopping_acceleration


class MpcController(Controller):
    """Controller that plans H steps ahead around the predicted vehicles and applies the first input.

    A plan is searched from the last one, shifted by one step; the first plan from each of the initial guesses
    (``avrare_mpc.plan.initial_guesses``), where the cheapest result counts. A failed search is counted, never
    raised: the particle follows its old plan and, once that has ended, brakes straight ahead. The turn
    rate of an old plan is clipped to ``lateral_acceleration_max`` at the current speed. Where a plan does not
    pass a vehicle, bends too sharply or ends with its lane, the ego brakes more than planned.

    Args:
        config: Options.
        scene: Road and sizes.

    Raises:
        UsageError: The road lacks a lane of the configuration.
    """

    def __init__(self, config: MpcConfig, scene: Scene) -> None:
        self.horizon = config.horizon
        self._config = config
        self._scene = scene
        road, offsets = scene.road, lane_centres(config, scene)
        self._gaps = find_gaps(road, config.lanes if config.lane_ends else ())
        self._search = _backend(config, self._gaps.fill(scene))
        self._bend_speed = None
        if road.line is not None and config.bend_acceleration is not None:
            braking = min(config.bend_braking, config.acceleration_max)
            self._bend_speed = BendSpeed(road.line, offsets, config.bend_acceleration, braking)

    def start(self, n: int) -> Memory:
        """Return the memory of ``n`` particles without a plan."""
        zeros = np.zeros(n, dtype=np.int64)
        return Memory(
            plan_states=np.zeros((n, self.horizon + 1, 4)),
            plan_inputs=np.zeros((n, self.horizon, 2)),
            solved=np.zeros(n, dtype=np.bool_),
            age=zeros,
            solves=zeros.copy(),
            retries=zeros.copy(),
            fallbacks=zeros.copy(),
            start_policy=np.full(n, -1, dtype=np.int64),
        )

    def alternatives(self) -> dict[str, Controller]:
        """Return one that brakes earlier, or stops at all, and one that searches more plans."""
        changes: dict[str, dict[str, object]] = {"stops where it cannot pass": {"stops": True}}
        if self._config.stops:
            changes = {"brakes earlier": {"stop_braking": 0.5 * self._config.stop_braking}}
        if self._config.search != "everywhere":
            changes["looks for a plan everywhere"] = {"search": "everywhere"}
        return {
            name: MpcController(self._config.model_copy(update=change), self._scene)
            for name, change in changes.items()
        }

    def plan(self, memory: Memory) -> Floats:
        """Return the planned states (N, H + 1, 4)."""
        return memory.plan_states

    def act(self, memory: Memory, ego: Vehicles, prediction: Prediction | None) -> tuple[Action, Memory]:
        """Return the first input of each particle's new plan, and the new memory.

        Args:
            memory: Plans and counters.
            ego: Current state, fields (N,).
            prediction: The other vehicles, at least H + 1 samples; one at infinity does not exist.

        Raises:
            UsageError: The prediction is missing or too short.
        """
        vehicles = others = self._list_predictions(prediction)
        line, wheelbase = self._scene.road.line, self._config.wheelbase
        if line is not None:
            vehicles = others = measure_along_ego_offset(line, ego, others[0]), others[1]
        if len(self._gaps.edges):
            others = self._gaps.extend(others, ego, self._scene.road)
        if line is not None and wheelbase is not None:
            ego = replace(ego, heading=ego.heading + road_slip_angle(line, ego, wheelbase))
        start = start_of(ego, np.where(memory.solved, memory.plan_inputs[:, 0, 1], 0.0))
        old = shift(memory.plan_states, memory.plan_inputs, self._scene.dt)
        result = self._search(memory.solved, start, old, others)
        feasible = result.feasible
        states = np.where(feasible[:, None, None], result.states, old[0])
        inputs = np.where(feasible[:, None, None], result.inputs, old[1])
        age = np.where(feasible, 0, memory.age + 1)
        solved = feasible | (memory.solved & (age < self.horizon))
        first_plan = feasible & ~memory.solved
        later = Memory(
            plan_states=states,
            plan_inputs=inputs,
            solved=solved,
            age=age,
            solves=memory.solves + result.solves,
            retries=memory.retries + result.retries,
            fallbacks=memory.fallbacks + ~feasible,
            start_policy=np.where(first_plan, result.chosen, memory.start_policy),
        )
        action = self._action(solved, inputs[:, 0], ego.speed)
        if line is not None:
            action = replace(action, yaw_rate=self._turn_with_road(action.yaw_rate, ego, line))
        slower = self._slow_down(action.acceleration, ego, states, vehicles)
        return replace(action, acceleration=slower), later

    def _slow_down(
        self, acceleration: Floats, ego: Vehicles, states: Floats, vehicles: tuple[Floats, Floats]
    ) -> Floats:
        # Bends, ends of lanes and vehicles in the way may need more time than the plan has.
        limits, dt = [], self._scene.dt
        ahead = replace(ego, x=ego.x + dt * ego.speed)
        if self._bend_speed is not None:
            limits.append(self._bend_speed.limit(ahead))
        if len(self._gaps.edges):
            goal = states[:, -1, 1]
            braking = min(self._config.end_braking, self._config.acceleration_max)
            limits.append(self._gaps.speed_limit(ahead, goal, self._scene, braking))
        for limit in limits:
            needed = np.maximum((limit - ego.speed) / dt, -self._config.acceleration_max)
            acceleration = np.fmin(acceleration, needed)  # a speed that is NaN needs nothing
        if self._config.stops:
            braking = min(self._config.stop_braking, self._config.acceleration_max)
            needed = stopping_acceleration(states, vehicles, self._scene, braking)
            acceleration = np.fmin(acceleration, np.maximum(needed, -self._config.acceleration_max))
        return acceleration

    def _turn_with_road(self, turn_rate: Floats, ego: Vehicles, line: ReferenceLine) -> Floats:
        # Both together keep the lateral bound, but what the road itself demands is always driven.
        road = road_yaw_rate(line, ego, self._scene.dt)
        lateral = self._config.lateral_acceleration_max
        if lateral is None:
            return turn_rate + road
        with np.errstate(divide="ignore"):
            limit = np.maximum(lateral / np.abs(ego.speed), np.abs(road))
        return np.clip(turn_rate + road, -limit, limit)

    def counts(self, memory: Memory) -> dict[str, NDArray[np.int64]]:
        """Return the counters to report, each (N,)."""
        return {
            "solves": memory.solves,
            "solver_retries": memory.retries,
            "fallback_solves": memory.fallbacks,
        }

    def _list_predictions(self, prediction: Prediction | None) -> tuple[Floats, Floats]:
        if prediction is None:
            raise UsageError("the controller mpc needs predictions", hint="name a tracker in the scenario")
        nodes = self.horizon + 1
        if prediction.x.shape[2] < nodes:
            raise UsageError(f"the controller mpc needs {self.horizon} predicted steps")
        # a vehicle at infinity is put where it costs a plan exactly nothing [m]
        x, y = (np.where(np.isposinf(part), 1e6, part) for part in (prediction.x, prediction.y))
        return x[:, :, :nodes], y[:, :, :nodes]

    def _action(self, planned: Bools, first: Floats, speed: Floats) -> Action:
        limit, lateral = self._config.acceleration_max, self._config.lateral_acceleration_max
        turn_rate = first[:, 1]
        if lateral is not None:  # an old plan was made for another speed
            with np.errstate(divide="ignore"):
                turn_rate = np.clip(turn_rate, -lateral / np.abs(speed), lateral / np.abs(speed))
        stopping = np.nan_to_num(-speed / self._scene.dt, nan=-limit)
        return Action(
            acceleration=np.where(planned, first[:, 0], np.clip(stopping, -limit, limit)),
            yaw_rate=np.where(planned, turn_rate, 0.0),
        )


def _backend(config: MpcConfig, scene: Scene) -> Search:
    # imported here because each backend brings its own compiler
    if config.backend == "riccati":
        from avrare_mpc.riccati.solver import RiccatiSearch

        return RiccatiSearch(config, scene)
    from avrare_mpc.casadi_search import CasadiSearch

    if "backend" not in config.model_fields_set and multiprocessing.parent_process() is None:
        _warn_of_casadi()
    return CasadiSearch(config, scene)


@functools.cache  # once in a process, and not in its workers
def _warn_of_casadi() -> None:
    warnings.warn(
        "numba is not installed: the controller mpc uses casadi, which takes dozens of times longer "
        "(pip install 'avrare-mpc[fast]'; `backend: casadi` in the scenario is taken as meant)",
        stacklevel=4,
    )


def build(config: MpcConfig, scene: Scene) -> MpcController:
    """Build the controller of a scenario; compiles the programme."""
    return MpcController(config, scene)
