"""The simulator: a single-track ego among scripted vehicles. It has no randomness of its own."""

from __future__ import annotations

import numpy as np

from avrare.driving import Action, Road, Scene, Vehicles, World
from avrare.driving.geometry import ego_rectangle, other_rectangles, signed_distance
from avrare.errors import UsageError
from avrare.protocols import Bools, Floats, Signals
from avrare_single_track.config import SingleTrackConfig
from avrare_single_track.plant import advance
from avrare_single_track.traffic import ScriptedTraffic


def build(config: SingleTrackConfig, scene: Scene | None = None) -> SingleTrack:
    """The simulator of a scenario."""
    return SingleTrack(config)


class SingleTrack:
    """A batch of identical roads, one per particle.

    Attributes:
        dt: Step [s].
        noise_size: 0.
        scene: Road, sizes and names.
    """

    noise_size = 0

    def __init__(self, config: SingleTrackConfig) -> None:
        self.config = config
        self.dt = config.dt
        road = config.road
        vehicles = config.vehicles
        self.scene = Scene(
            dt=config.dt,
            road=Road(road.lane_centres, road.lane_width, road.access_ramp, road.begin, road.end),
            ego_length=config.ego.length,
            ego_width=config.ego.width,
            names=tuple(vehicle.name for vehicle in vehicles),
            lengths=np.array([vehicle.length for vehicle in vehicles]),
            widths=np.array([vehicle.width for vehicle in vehicles]),
            moving=np.array(
                [vehicle.speed > 0.0 or vehicle.drive is not None for vehicle in vehicles], dtype=bool
            ),
        )
        self.traffic = ScriptedTraffic(vehicles, self.scene.road, self.dt)

    def reset(self, noise: Floats) -> World:
        """All particles at the scenario's start."""
        n = len(noise)
        ego = self.config.ego
        start = Vehicles(*(np.full(n, value) for value in (ego.x, ego.y, ego.heading, ego.speed, 0.0)))
        step = np.zeros(n, dtype=np.int64)
        return World(step, start, self.traffic.at(step), np.zeros(n))

    def step(self, world: World, action: Action | None, noise: Floats) -> World:
        """World one ``dt`` later.

        Raises:
            UsageError: There is no controller.
        """
        if action is None:
            raise UsageError("single_track needs a controller", "add a `controller:` block to the scenario")
        ego, steering = advance(self.config.ego, self.dt, world.ego, world.steering, action)
        step = world.step + 1
        return World(step, ego, self.traffic.at(step), steering)

    def signals(self, world: World) -> Signals:
        """``ego_*`` (N,), ``others_*`` (N, V), ``distance`` (N, V) to each, ``gap`` (N,) the least."""
        fields = ("x", "y", "heading", "speed", "acceleration")
        named = {f"ego_{name}": getattr(world.ego, name) for name in fields}
        named |= {f"others_{name}": getattr(world.others, name) for name in fields}
        distance = signed_distance(
            ego_rectangle(world.ego, self.scene), other_rectangles(world.others, self.scene)
        )
        return {**named, "distance": distance, "gap": distance.min(axis=1, initial=np.inf)}

    def faults(self, world: World) -> Bools:
        """(N,) rows whose ego state is not finite."""
        ego = world.ego
        return ~(np.isfinite(ego.x) & np.isfinite(ego.y) & np.isfinite(ego.heading) & np.isfinite(ego.speed))
