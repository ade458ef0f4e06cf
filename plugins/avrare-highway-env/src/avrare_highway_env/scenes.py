"""highway-env's worlds, mended where needed, and what each of them is to a simulator."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from highway_env.envs.highway_env import HighwayEnv
from highway_env.envs.intersection_env import IntersectionEnv
from highway_env.envs.merge_env import ConnectedLaneMergeEnv
from highway_env.envs.roundabout_env import RoundaboutEnv
from highway_env.vehicle.kinematics import Vehicle
from highway_env.vehicle.objects import Obstacle

from avrare.driving import Road, Scene
from avrare_highway_env.config import HighwayEnvConfig
from avrare_highway_env.drivers import LightEgo
from avrare_highway_env.lanes import flatten

LANE_WIDTH = 4.0
"""Of every lane of highway-env [m]."""


class Steered:
    """Mends environments whose reward asks ``action in [0, 2]``, which a continuous action cannot answer."""

    def _rewards(self, action: Any) -> dict[str, float]:
        return super()._rewards(1)  # type: ignore[misc, no-any-return]  # 1 is "no lane change"


class Merge(Steered, ConnectedLaneMergeEnv):  # type: ignore[misc]
    """The merge, with continuous actions."""

    def _make_road(self) -> None:
        super()._make_road()
        flatten(self.road.network)


class Highway(HighwayEnv):  # type: ignore[misc]
    """The highway."""

    def _create_road(self) -> None:
        super()._create_road()
        flatten(self.road.network)


class Intersection(IntersectionEnv):  # type: ignore[misc]
    """The intersection; vehicles come and go."""

    def _make_vehicles(self, n_vehicles: int = 10) -> None:
        super()._make_vehicles(n_vehicles)
        self.vehicle.__class__ = LightEgo

    def renew(self) -> None:
        """What the environment does after every step: vehicles leave, and others may come."""
        self._clear_vehicles()
        self._spawn_vehicle(spawn_probability=self.config["spawn_probability"])


class Roundabout(Steered, RoundaboutEnv):  # type: ignore[misc]
    """The roundabout, with continuous actions; a run is over on any of the straight roads that leave it."""

    def has_arrived(self, vehicle: Any) -> bool:
        """Whether a vehicle has left, as the intersection says it."""
        return vehicle.lane_index[1] in ("exr", "sxr", "nxr", "wxr")


@dataclass(frozen=True)
class Setting:
    """What a simulator needs to know of a scene.

    Attributes:
        environment: Its class.
        options: highway-env's configuration.
        capacity: Most other vehicles, obstacles included.
        draws: Random numbers of every step after the start.
        goal: x at which the run is over [m]; None: the scene knows, or it is never over.
        road: The straight lanes, None where there are none.
    """

    environment: type[Any]
    options: dict[str, Any]
    capacity: int
    draws: int
    goal: float | None
    road: Road | None


def setting_of(config: HighwayEnvConfig) -> Setting:
    """The setting of a scenario's scene."""
    makers = {"merge": _merge, "highway": _highway, "intersection": _intersection, "roundabout": _roundabout}
    return makers[config.scene](config)


def _options(driver: str, **own: Any) -> dict[str, Any]:
    return {
        "action": {"type": "ContinuousAction"},
        "observation": {"type": "Kinematics", "vehicles_count": 1},  # of no use, but never drawn
        "other_vehicles_type": f"avrare_highway_env.drivers.{driver}",
        **own,
    }


def _merge(config: HighwayEnvConfig) -> Setting:
    goal = 370.0 if config.goal is None else config.goal
    # right to left: the parallel part of the ramp, the ego's lane, the left lane
    road = Road((-2 * LANE_WIDTH, -LANE_WIDTH, 0.0), LANE_WIDTH, access_ramp=(0,), begin=0.0, end=460.0)
    return Setting(Merge, _options("MoodyDriver"), 5, 0, goal, road)


def _highway(config: HighwayEnvConfig) -> Setting:
    count = 10 if config.vehicles is None else config.vehicles
    options = _options("MoodyDriver", vehicles_count=count, lanes_count=config.lanes)
    centres = tuple(-LANE_WIDTH * lane for lane in reversed(range(config.lanes)))
    return Setting(Highway, options, count, 0, config.goal, Road(centres, LANE_WIDTH, begin=0.0, end=1000.0))


def _intersection(config: HighwayEnvConfig) -> Setting:
    count = 10 if config.vehicles is None else config.vehicles
    # highway-env's 0.6 is for one step a second
    options = _options("IntersectionDriver", initial_vehicle_count=count, spawn_probability=0.6 * config.dt)
    return Setting(Intersection, options, count + 30, 6, None, None)


def _roundabout(config: HighwayEnvConfig) -> Setting:
    return Setting(Roundabout, _options("MoodyDriver"), 4, 0, None, None)


def scene_of(road: Road, dt: float, objects: list[Any]) -> Scene:
    """Road, sizes and names of a fixed population, whose first member is the ego."""
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
