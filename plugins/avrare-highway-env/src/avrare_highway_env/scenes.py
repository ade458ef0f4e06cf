"""Scenes of highway-env, corrected where needed, and their settings."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from highway_env.envs.highway_env import HighwayEnv
from highway_env.envs.intersection_env import IntersectionEnv
from highway_env.envs.merge_env import ConnectedLaneMergeEnv
from highway_env.envs.roundabout_env import RoundaboutEnv
from highway_env.road.lane import AbstractLane, CircularLane, StraightLane
from highway_env.road.road import RoadNetwork
from highway_env.vehicle.kinematics import Vehicle
from highway_env.vehicle.objects import Obstacle, RoadObject
from numpy.typing import NDArray

from avrare.driving import Road, Scene
from avrare_highway_env.config import HighwayEnvConfig
from avrare_highway_env.drivers import LightEgo


class FlatLane(StraightLane):  # type: ignore[misc]
    """Straight lane along x, bit-identical to ``StraightLane``."""

    def local_coordinates(self, position: NDArray[np.float64]) -> tuple[float, float]:
        """Return coordinates along and across the lane [m]; products with (1, 0) and (0, 1) are exact."""
        x, y = position.tolist()
        return x - self.origin[0], y - self.origin[1]

    @classmethod
    def of(cls, lane: StraightLane) -> FlatLane:
        """Convert a lane."""
        flat: Any = object.__new__(cls)
        vars(flat).update(vars(lane))
        flat.origin = tuple(float(part) for part in lane.start)
        return flat  # type: ignore[no-any-return]


def flatten(network: RoadNetwork) -> None:
    """Replace every straight lane along x of a road network."""
    for targets in network.graph.values():
        for lanes in targets.values():
            lanes[:] = [FlatLane.of(lane) if _along_x(lane) else lane for lane in lanes]


def _along_x(lane: AbstractLane) -> bool:
    return type(lane) is StraightLane and lane.direction.tolist() == [1.0, 0.0]


RING_RADIUS, START_SPEED = 20.0, 16.0
"""Radius of the roundabout's inner lane [m], and mean speed of its drivers at the start [m/s]."""
LANE_WIDTH = 4.0
"""Width of every lane of highway-env [m]."""


class Steered:
    """Mixin for environments whose reward tests ``action in [0, 2]``, which fails for continuous actions."""

    def _rewards(self, action: object) -> dict[str, float]:
        return super()._rewards(1)  # type: ignore[misc, no-any-return]  # 1 is "no lane change"


class Merge(Steered, ConnectedLaneMergeEnv):  # type: ignore[misc]
    """Merge scene with continuous actions."""

    def _make_road(self) -> None:
        super()._make_road()
        flatten(self.road.network)


class Highway(HighwayEnv):  # type: ignore[misc]
    """Highway scene."""

    def _create_road(self) -> None:
        super()._create_road()
        flatten(self.road.network)


class Intersection(IntersectionEnv):  # type: ignore[misc]
    """Intersection scene; vehicles come and go.

    The other drivers keep to the lateral acceleration ``bend_acceleration`` of its configuration, if any.
    """

    def _make_road(self) -> None:
        super()._make_road()
        limit = self.config["bend_acceleration"]
        for lane in self.road.network.lanes_list() if limit is not None else ():
            if isinstance(lane, CircularLane):
                lane.speed_limit = min(lane.speed_limit, float(np.sqrt(limit * lane.radius)))

    def _make_vehicles(self, n_vehicles: int = 10) -> None:
        super()._make_vehicles(n_vehicles)
        self.vehicle.__class__ = LightEgo

    def renew(self) -> None:
        """Remove vehicles that have left and spawn new ones, as the environment does after every step."""
        self._clear_vehicles()
        self._spawn_vehicle(spawn_probability=self.config["spawn_probability"])


class Roundabout(Steered, RoundaboutEnv):  # type: ignore[misc]
    """Roundabout scene with continuous actions; a rollout is over on any of its exits.

    The other drivers keep to the lateral acceleration ``bend_acceleration`` of its configuration, if any.
    """

    def _make_road(self) -> None:
        super()._make_road()
        limit = self.config["bend_acceleration"]
        for lane in self.road.network.lanes_list() if limit is not None else ():
            radius = lane.radius if isinstance(lane, CircularLane) else RING_RADIUS
            lane.speed_limit = float(np.sqrt(limit * radius))

    def _make_vehicles(self) -> None:
        super()._make_vehicles()
        limit = self.config["bend_acceleration"]
        for driver in self.road.vehicles[1:] if limit is not None else ():
            driver.speed *= np.sqrt(limit * RING_RADIUS) / START_SPEED

    def has_arrived(self, vehicle: Vehicle) -> bool:
        """Return whether a vehicle has left the roundabout."""
        return vehicle.lane_index[1] in ("exr", "sxr", "nxr", "wxr")


@dataclass(frozen=True)
class Setting:
    """Setting of a scene.

    Attributes:
        environment: Class of the environment.
        options: Configuration of highway-env.
        capacity: Maximal number of other vehicles and obstacles.
        draws: Random numbers per step after the start.
        goal: x at which a rollout is over [m]; None: the scene decides, or it is never over.
        road: Straight lanes, None if there are none.
    """

    environment: type[Any]
    options: dict[str, Any]
    capacity: int
    draws: int
    goal: float | None
    road: Road | None


def setting_of(config: HighwayEnvConfig) -> Setting:
    """Return the setting of a scenario's scene."""
    makers = {"merge": _merge, "highway": _highway, "intersection": _intersection, "roundabout": _roundabout}
    return makers[config.scene](config)


def _options(driver: str, **options: object) -> dict[str, object]:
    return {
        "action": {"type": "ContinuousAction"},
        "observation": {"type": "Kinematics", "vehicles_count": 1},  # unused, but required
        "other_vehicles_type": f"avrare_highway_env.drivers.{driver}",
        **options,
    }


def _merge(config: HighwayEnvConfig) -> Setting:
    goal = 370.0 if config.goal is None else config.goal
    # From right to left: the parallel part of the ramp, the ego's lane, the left lane
    road = Road((-2 * LANE_WIDTH, -LANE_WIDTH, 0.0), LANE_WIDTH, access_ramp=(0,), begin=0.0, end=460.0)
    return Setting(Merge, _options("MoodyDriver"), 5, 0, goal, road)


def _highway(config: HighwayEnvConfig) -> Setting:
    count = 10 if config.vehicles is None else config.vehicles
    options = _options("MoodyDriver", vehicles_count=count, lanes_count=config.lanes)
    centres = tuple(-LANE_WIDTH * lane for lane in reversed(range(config.lanes)))
    return Setting(Highway, options, count, 0, config.goal, Road(centres, LANE_WIDTH, begin=0.0, end=1000.0))


def _intersection(config: HighwayEnvConfig) -> Setting:
    count = 10 if config.vehicles is None else config.vehicles
    # highway-env's 0.6 is per second
    options = _options(
        "IntersectionDriver",
        initial_vehicle_count=count,
        spawn_probability=0.6 * config.dt,
        bend_acceleration=config.traffic.bend_acceleration,
    )
    return Setting(Intersection, options, count + 30, 6, None, None)


def _roundabout(config: HighwayEnvConfig) -> Setting:
    options = _options("MoodyDriver", bend_acceleration=config.traffic.bend_acceleration)
    return Setting(Roundabout, options, 4, 0, None, None)


def scene_of(road: Road, dt: float, objects: list[RoadObject]) -> Scene:
    """Return road, sizes and names of fixed objects, of which the first is the ego."""
    ego, others = objects[0], objects[1:]
    return Scene(
        dt=dt,
        road=road,
        ego_length=float(ego.LENGTH),
        ego_width=float(ego.WIDTH),
        names=tuple(
            f"obstacle_{k}" if isinstance(other, Obstacle) else f"vehicle_{k}"
            for k, other in enumerate(others)
        ),
        lengths=np.array([other.LENGTH for other in others], dtype=np.float64),
        widths=np.array([other.WIDTH for other in others], dtype=np.float64),
        moving=np.array([isinstance(other, Vehicle) for other in others], dtype=bool),
    )
