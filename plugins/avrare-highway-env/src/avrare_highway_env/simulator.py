"""highway-env as a simulator: one environment, with the worlds of all particles as snapshots."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from avrare.base import batch
from avrare.driving import Road, Scene, Vehicles
from avrare.driving.geometry import Rectangle, signed_distance
from avrare.protocols import Bools, Floats, Signals, Simulator
from avrare_highway_env.actions import native_action
from avrare_highway_env.config import HighwayEnvConfig
from avrare_highway_env.drivers import MoodyDriver
from avrare_highway_env.junction import crossing_road, label_vehicles, list_paths, read_ways
from avrare_highway_env.scenes import LANE_WIDTH, scene_of, setting_of
from avrare_highway_env.sensing import Ego, Sensors
from avrare_highway_env.tape import TapeRandom
from avrare_highway_env.worlds import EGO, capture, gap_ahead, others_of, read, restore

_BEYOND_TYRES = {
    "roundabout": "the other drivers go round a ring of 20 m at 16 m/s, 1.3 g to the side",
    "intersection": "the other drivers turn right on a radius of 9 m at 10 m/s, 1.1 g to the side",
}
"""Warnings of scenes whose drivers have no ``traffic.bend_acceleration``."""


def build(config: HighwayEnvConfig, scene: object | None = None) -> HighwayEnvSimulator:
    """Build the simulator of a scenario."""
    return HighwayEnvSimulator(config)


@dataclass(frozen=True)
class HighwayWorld:
    """Worlds of N particles.

    Attributes:
        snapshot: (N,) objects, ``worlds.Snapshot``.
        ego: Ego with fields (N,) and its observation.
        others: Other vehicles with fields (N, V); absent ones are 1000 km away.
        crashed: (N,) the ego has collided.
        arrived: (N,) the ego has reached its goal, on the road.
        on_road: (N,) the ego's centre is on a lane.
        over: (N,) crashed or past the goal: the world stops.
        ways: (N, V) numbers of the others' ways over the intersection, -1 without; None: there is none.
    """

    snapshot: NDArray[np.object_]
    ego: Ego
    others: Vehicles
    crashed: Bools
    arrived: Bools
    on_road: Bools
    over: Bools
    ways: Floats | None = None


class HighwayEnvSimulator(Simulator):
    """Batch of worlds on one road.

    A row of noise contains the numbers of the start (used only at t = 0), of the environment's own draws, of
    the drivers' moods, and of the rays.

    Attributes:
        dt: Step [s].
        noise_size: Numbers per row, depending on the options.
        scene: Road, sizes and names if the lanes are straight, else None.
        warnings: Health warning of speeds that no car drives.
        junction: Plane without lanes of intersection and roundabout, with the ways over the intersection.
        environment: Environment of highway-env, in the state of the last particle.
    """

    def __init__(self, config: HighwayEnvConfig) -> None:
        self.config, self.dt = config, config.dt
        self.setting = setting_of(config)
        self.environment = self.setting.environment(self.setting.options)
        self.sensors = Sensors(config.lidar)
        capacity = self.setting.capacity
        start = TapeRandom(np.zeros(0))
        self._place(start)
        sizes = (
            0 if config.start_seed is not None else start.used,
            self.setting.draws,
            capacity if config.traffic.acceleration_sd else 0,
            self.sensors.noise_size,
        )
        ends = np.cumsum((0, *sizes)).tolist()
        self._start, self._draws, self._moods, self._rays = (slice(*pair) for pair in pairwise(ends))
        self.noise_size = int(ends[-1])
        ego = self.environment.vehicle
        self._ego_size = float(ego.LENGTH), float(ego.WIDTH)
        self._lengths, self._widths = (np.full(capacity, size) for size in self._ego_size)
        tuned_names = ("desired_speed", "time_gap", "acceleration", "deceleration")
        tuned = {f"traffic.{name}": getattr(config.traffic, name) for name in tuned_names}
        self._fixed = {
            name: value
            for name, value in {**tuned, "ego_speed": config.ego_speed}.items()
            if value is not None
        }
        self.warnings = {}
        if config.scene in _BEYOND_TYRES and config.traffic.bend_acceleration is None:
            text = (
                f"{_BEYOND_TYRES[config.scene]}, which no car does: give traffic.bend_acceleration, such as 3"
            )
            self.warnings = {"beyond_tyres": text}
        self.scene: Scene | None = None
        if self.setting.road is not None:
            objects = [*self.environment.road.vehicles, *self.environment.road.objects]
            self.scene = scene_of(self.setting.road, config.dt, objects)
            self._lengths, self._widths = self.scene.lengths, self.scene.widths

        self.junction: Scene | None = None
        if self.scene is None:
            network, road = self.environment.road.network, Road((), LANE_WIDTH)
            if config.scene == "intersection":
                road = crossing_road(network, config.way)
            road = replace(road, paths=list_paths(network))
            names = tuple(f"vehicle_{slot}" for slot in range(capacity))
            sizes_of = self._lengths, self._widths, np.ones(capacity, dtype=bool)
            self.junction = Scene(config.dt, road, *self._ego_size, names, *sizes_of)
        self._numbered = config.scene == "intersection"

    def reset(self, noise: Floats) -> HighwayWorld:
        """Return the worlds at t = 0 from noise (N, noise_size)."""
        return self.reset_drawn(noise, {})

    def drawing(self, laws: Mapping[str, object]) -> HighwayEnvSimulator:
        """Return the simulator itself: values of options belong to each world."""
        return self

    def reset_drawn(self, noise: Floats, values: Mapping[str, Floats]) -> HighwayWorld:
        """Return the worlds at t = 0 with drawn values (N,) of some options."""
        seed = self.config.start_seed

        def place(row: int) -> None:
            tape = TapeRandom(noise[row, self._start])
            self._place(tape if seed is None else np.random.default_rng(seed))
            self._tune({**self._fixed, **{path: float(value[row]) for path, value in values.items()}})

        return self._worlds(place, noise)

    def step(self, world: HighwayWorld, action: object, noise: Floats) -> HighwayWorld:
        """Return the worlds one ``dt`` later; those that are over do not change.

        Args:
            world: Current worlds.
            action: ``avrare.driving.Action``, or (N, 2) throttle and steering in [-1, 1], left is positive.
            noise: Noise (N, noise_size).

        Raises:
            UsageError: The controller is missing, or its action has the wrong shape.
        """
        running = np.flatnonzero(~world.over)
        if not running.size:
            return world
        wanted = native_action(action, world.ego, self._ego_size[0])[running]
        snapshots, numbers = world.snapshot[running], noise[running]

        def drive(row: int) -> None:
            restore(self.environment, snapshots[row])
            self._advance(wanted[row], numbers[row])

        def put(old: NDArray[np.generic], new: NDArray[np.generic]) -> NDArray[np.generic]:
            leaf = old.copy()
            leaf[running] = new
            return leaf

        after = self._worlds(drive, numbers)
        if running.size == world.over.size:
            return after
        return batch.map_leaves(put, world, after)

    def signals(self, world: HighwayWorld) -> Signals:
        """Return the signals by name.

        ``ego_*`` (N,) and ``others_*`` (N, V) as for every driving simulator, ``distance`` (N, V) to each
        vehicle and ``gap`` (N,), the smallest; ``x``, ``y``, ``heading``, ``speed``, ``acceleration`` of the
        ego; ``gap_ahead`` [m], and ``crashed``, ``arrived``, ``on_road``, ``over`` as 0 or 1. At the
        intersection also ``others_way`` (N, V), the number of each vehicle's way.
        """
        fields = ("x", "y", "heading", "speed", "acceleration")
        named = {f"{prefix}{name}": getattr(world.ego, name) for name in fields for prefix in ("ego_", "")}
        named |= {f"others_{name}": getattr(world.others, name) for name in fields}
        named |= {
            name: getattr(world, name).astype(np.float64)
            for name in ("crashed", "arrived", "on_road", "over")
        }
        ego, others, sizes = world.ego, world.others, (self._lengths, self._widths)
        distance = signed_distance(
            Rectangle(ego.x[:, None], ego.y[:, None], ego.heading[:, None], *map(np.asarray, self._ego_size)),
            Rectangle(others.x, others.y, others.heading, *sizes),
        )
        if world.ways is not None:
            named["others_way"] = world.ways
        named["gap_ahead"] = gap_ahead(ego, self._ego_size, others, *sizes)
        return {**named, "distance": distance, "gap": distance.min(axis=1, initial=np.inf)}

    def ended(self, world: HighwayWorld) -> Bools:
        """Return (N,) the drives that a collision has ended."""
        return world.crashed

    def faults(self, world: HighwayWorld) -> Bools:
        """Return (N,) rows whose ego state is not finite."""
        ego = world.ego
        return ~(np.isfinite(ego.x) & np.isfinite(ego.y) & np.isfinite(ego.heading) & np.isfinite(ego.speed))

    def _place(self, random: object) -> None:
        self.environment._np_random = random
        self.environment._reset()

    def _tune(self, options: dict[str, float]) -> None:
        # The ego carries what was drawn, as an attribute that snapshots copy.
        ego = self.environment.vehicle
        ego.options = options
        ego.speed = options.get("ego_speed", ego.speed)
        self._tune_drivers(options)

    def _tune_drivers(self, options: Mapping[str, float]) -> None:
        # Those that have come since as well.
        traffic = {path.removeprefix("traffic."): value for path, value in options.items() if "." in path}
        for driver in self.environment.road.vehicles if traffic else ():
            if isinstance(driver, MoodyDriver) and not driver.tuned:
                driver.tune(traffic)

    def _advance(self, action: Floats, noise: Floats) -> None:
        environment = self.environment
        environment._np_random = environment.road.np_random = TapeRandom(noise[self._draws])
        self._set_moods(noise[self._moods])
        for vehicle in environment.road.vehicles:
            vehicle.speed_before, vehicle.pushed = vehicle.speed, None
        environment.action_type.act(action)
        for _ in range(self.config.substeps):
            for vehicle in environment.road.vehicles:
                vehicle.pushed = vehicle.pushed if vehicle.impact is None else vehicle.impact
            environment.road.act()
            environment.road.step(self.dt / self.config.substeps)
        if hasattr(environment, "renew"):
            environment.renew()
            self._tune_drivers(environment.vehicle.options)

    def _set_moods(self, noise: Floats) -> None:
        """Advance the moods by the exact transition of an Ornstein-Uhlenbeck process that starts at 0."""
        traffic = self.config.traffic
        decay = np.exp(-self.dt / traffic.correlation_time)
        spread = self.environment.vehicle.options.get("traffic.acceleration_sd", traffic.acceleration_sd)
        innovation = spread * np.sqrt(1.0 - decay**2)
        drivers = [vehicle for vehicle in self.environment.road.vehicles if isinstance(vehicle, MoodyDriver)]
        for driver, number in zip(drivers, noise, strict=False):
            driver.mood = float(decay * driver.mood + innovation * number)

    def _worlds(self, move: Callable[[int], None], noise: Floats) -> HighwayWorld:
        """Apply ``move(row)`` to the environment for every row of noise and collect the worlds."""
        snapshots, readings = np.empty(len(noise), dtype=object), []
        ways: list[list[float]] = []
        for row in range(len(noise)):
            move(row)
            if self._numbered:
                label_vehicles(self.environment)
                ways.append(read_ways(self.environment, self.setting.capacity))
            snapshots[row] = capture(self.environment)
            readings.append(read(self.environment, self.setting.capacity, self.setting.goal, self.dt))
        table = np.array(readings, dtype=np.float64)
        others = others_of(table)
        x, y, heading, speed, acceleration, steering = (column.copy() for column in table.T[:6])
        ego = self.sensors.observe(
            Vehicles(x, y, heading, speed, acceleration),
            steering,
            others,
            self._lengths,
            self._widths,
            noise[:, self._rays],
        )
        crashed, arrived, on_road, over = (column.astype(bool) for column in table.T[6 : len(EGO)])
        numbered = np.array(ways, dtype=np.float64) if self._numbered else None
        return HighwayWorld(snapshots, ego, others, crashed, arrived, on_road, over, numbered)
