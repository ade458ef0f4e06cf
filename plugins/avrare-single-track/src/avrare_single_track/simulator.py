"""Simulator: a single-track ego among scripted vehicles; options may be drawn, nothing else is random."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from avrare.base.errors import UsageError
from avrare.driving import Action, Lane, Road, Scene, Vehicles, World
from avrare.driving.geometry import ego_rectangle, interpolate, other_rectangles, signed_distance
from avrare.driving.lanes import ENDLESS
from avrare.driving.reference_line import CurvedLine, Piece, ReferenceLine
from avrare.driving.values import to_plane, to_road
from avrare.protocols import Bools, Floats, Signals, Simulator
from avrare_single_track.config import RoadConfig, SingleTrackConfig, VehicleConfig
from avrare_single_track.drawn_traffic import DrawnTraffic, Mixture
from avrare_single_track.drive_metrics import lateral_acceleration, time_to_collision
from avrare_single_track.impact import end_at_impact
from avrare_single_track.plant import advance
from avrare_single_track.reactive_traffic import DriverMemory, ReactiveTraffic


def build(config: SingleTrackConfig, scene: Scene | None = None) -> SingleTrack:
    """Build the simulator of a scenario."""
    return SingleTrack(config)


@dataclass(frozen=True)
class TrackWorld(World):
    """State of the simulator.

    Attributes:
        jerk: (N,) change of the acceleration, along and across the ego, over the last step [m/s^3].
        slips: (N,) number of steps so far whose demand was beyond the friction circle.
        friction: (N,) drawn friction coefficient; None: that of the options.
        plans: Place among the plans of the scripted vehicles, where they are drawn.
        drivers: Memory of the drivers that react, if there are any.
        ended: (N,) the ego has touched a vehicle, which ended the drive; None: it continues.
    """

    jerk: Floats
    slips: NDArray[np.int64]
    friction: Floats | None = None
    plans: Mixture | None = None
    drivers: DriverMemory | None = None
    ended: Bools | None = None


class SingleTrack(Simulator):
    """Batch of identical roads, one per particle.

    Attributes:
        dt: Step [s].
        noise_size: One number for each driver that reacts, the noise of its acceleration, and one for each
            whose reaction time varies.
        scene: Road, sizes and names.
    """

    scene: Scene
    _substeps = 1

    def __init__(self, config: SingleTrackConfig) -> None:
        self.config = config
        self._substeps = config.substeps
        self.dt = config.dt
        vehicles = config.vehicles
        self.scene = Scene(
            dt=config.dt,
            road=build_road(config.road),
            ego_length=config.ego.length,
            ego_width=config.ego.width,
            names=tuple(vehicle.name for vehicle in vehicles),
            lengths=np.array([vehicle.length for vehicle in vehicles]),
            widths=np.array([vehicle.width for vehicle in vehicles]),
            moving=np.array(
                [vehicle.speed > 0.0 or bool(vehicle.drive or vehicle.driver) for vehicle in vehicles],
                dtype=bool,
            ),
        )
        self.traffic = ScriptedTraffic(vehicles, self.scene.road, self.dt)
        self.drawn_traffic: DrawnTraffic | None = None
        self.react(vehicles, self.scene)

    def react(self, vehicles: tuple[VehicleConfig, ...], scene: Scene) -> None:
        """Let those of a scene's vehicles react that have a driver."""
        self.reactive = ReactiveTraffic(vehicles, scene, self._substeps)
        self.noise_names = self.reactive.noise_names
        self.noise_size = len(self.noise_names)

    def reset(self, noise: Floats) -> TrackWorld:
        """Return the worlds at the scenario's start."""
        n = len(noise)
        ego = self.config.ego
        start = Vehicles(*(np.full(n, value) for value in (ego.x, ego.y, ego.heading, ego.speed, 0.0)))
        step = np.zeros(n, dtype=np.int64)
        weather = None if self.config.weather is None else np.full(n, self.config.weather)
        others = self.traffic.at(step)
        return TrackWorld(
            step,
            start,
            others,
            np.zeros(n),
            np.zeros(n),
            np.zeros_like(step),
            drivers=self.reactive.start(others, noise) if self.noise_size else None,
            weather=weather,
            ended=None if self.config.after_impact == "go_on" else np.zeros(n, dtype=np.bool_),
        )

    def drawing(self, laws: Mapping[str, object]) -> SingleTrack:
        """Return the same simulator, whose vehicles are planned for draws by these laws."""
        drawn = SingleTrack(self.config)
        if any(path.startswith("vehicles.") for path in laws):
            road, vehicles = self.scene.road, self.config.vehicles
            drawn.drawn_traffic = DrawnTraffic(vehicles, road, self.dt, laws, ScriptedTraffic)
        return drawn

    def reset_drawn(self, noise: Floats, values: Mapping[str, Floats]) -> TrackWorld:
        """Return the worlds at the start with drawn values (N,) of some options."""
        world = self.reset(noise)
        ego_values = {
            path.removeprefix("ego."): value for path, value in values.items() if path.startswith("ego.")
        }
        friction = ego_values.pop("friction", None)
        world = replace(world, ego=replace(world.ego, **ego_values), friction=friction)
        if (weather := values.get("weather")) is not None:
            world = replace(world, weather=weather)
        if self.drawn_traffic is not None:
            world = replace(world, plans=self.drawn_traffic.mix(values, len(noise)))
            world = replace(world, others=self._others(world.step, world.plans))
        if self.noise_size:
            world = replace(world, drivers=self.reactive.start(world.others, noise, values))
        return world

    def _others(self, step: NDArray[np.int64], plans: Mixture | None) -> Vehicles:
        if self.drawn_traffic is None or plans is None:
            return self.traffic.at(step)
        return self.drawn_traffic.at(step, plans)

    def step(self, world: TrackWorld, action: Action | None, noise: Floats) -> TrackWorld:
        """Return the world one ``dt`` later; one that an impact has ended does not change.

        Raises:
            UsageError: The controller is missing.
        """
        if action is None:
            raise UsageError("the ego needs a controller", "add a `controller:` block to the scenario")
        ego, steering, slips, moved_others = self._move(world, action, noise)
        before, now = self._lateral(world.ego, world.steering), self._lateral(ego, steering)
        jerk = np.hypot(ego.acceleration - world.ego.acceleration, now - before) / self.dt
        moved = replace(
            world,
            step=world.step + 1,
            ego=ego,
            steering=steering,
            jerk=jerk,
            slips=world.slips + slips,
            **moved_others,
        )
        return moved if world.ended is None else end_at_impact(self.scene, world, moved)

    def _move(
        self, world: TrackWorld, action: Action, noise: Floats
    ) -> tuple[Vehicles, Floats, Bools, dict[str, Any]]:
        # Ego, steering angle, slipping rows, and what changes besides.
        if self._substeps > 1:
            return self._move_in_substeps(world, action, noise)
        ego, steering, slips = self._drive(world.ego, world.steering, action, world.friction)
        return ego, steering, slips, self._move_others(world, noise)

    def _move_in_substeps(
        self, world: TrackWorld, action: Action, noise: Floats
    ) -> tuple[Vehicles, Floats, Bools, dict[str, Any]]:
        ego, steering, drivers, others = world.ego, world.steering, world.drivers, world.others
        slips, scripted = np.zeros(len(steering), dtype=np.bool_), self._others(world.step + 1, world.plans)
        for part in range(self._substeps):
            states = None
            if drivers is not None:
                substep = world.step * self._substeps + part
                drivers, states = self.reactive.move(drivers, substep, ego, others)
            ego, steering, slipping = self._drive(ego, steering, action, world.friction)
            slips |= slipping
            share = (part + 1) / self._substeps
            others = scripted if share == 1.0 else interpolate(world.others, scripted, share)
            others = others if states is None else self.reactive.place_drivers(others, states)
        if drivers is not None:
            drivers = self.reactive.change_moods(drivers, noise)
            changed = others.acceleration.copy()
            reacting = self.reactive.places
            changed[:, reacting] = ((others.speed - world.others.speed) / self.dt)[:, reacting]
            others = replace(others, acceleration=changed)
        ego = replace(ego, acceleration=(ego.speed - world.ego.speed) / self.dt)
        return ego, steering, slips, {"others": others, "drivers": drivers}

    def _drive(
        self, ego: Vehicles, steering: Floats, action: Action, friction: Floats | None
    ) -> tuple[Vehicles, Floats, Bools]:
        road, dt = self.scene.road, self.dt / self._substeps
        moved, angle, slips = advance(self.config.ego, dt, to_plane(road, ego), steering, action, friction)
        return moved if road.line is None else to_road(road.line, moved), angle, slips

    def ended(self, world: TrackWorld) -> Bools:
        """Return (N,) the drives that an impact has ended."""
        return np.zeros(len(world.step), dtype=np.bool_) if world.ended is None else world.ended

    def _move_others(self, world: TrackWorld, noise: Floats) -> dict[str, Any]:
        # What changes in a world within a step, besides the ego.
        others, drivers = self._others(world.step + 1, world.plans), world.drivers
        if drivers is not None:
            drivers, states = self.reactive.step(drivers, world.step, world.ego, world.others, noise)
            others = self.reactive.place_drivers(others, states)
        return {"others": others, "drivers": drivers}

    def _lateral(self, ego: Vehicles, steering: Floats) -> Floats:
        return lateral_acceleration(ego.speed, steering, self.config.ego.wheelbase)

    def counts(self, world: TrackWorld) -> dict[str, NDArray[np.int64]]:
        """Return (N,) the steps whose demand was beyond the friction circle, if there is one."""
        return {} if self.config.ego.friction is None else {"friction_saturations": world.slips}

    def signals(self, world: TrackWorld) -> Signals:
        """Return ``ego_*`` and levels (N,), ``others_*`` and ``distance`` (N, V), its minimum ``gap`` (N,).

        The levels are ``longitudinal_acceleration``, ``lateral_acceleration``, ``combined_acceleration``,
        ``jerk`` and ``time_to_collision`` (``avrare_single_track.drive_metrics``).
        """
        fields = ("x", "y", "heading", "speed", "acceleration")
        named = {f"ego_{name}": getattr(world.ego, name) for name in fields}
        named |= {f"others_{name}": getattr(world.others, name) for name in fields}
        distance = signed_distance(
            ego_rectangle(world.ego, self.scene), other_rectangles(world.others, self.scene)
        )
        across = self._lateral(world.ego, world.steering)
        return {
            **named,
            "distance": distance,
            "gap": distance.min(axis=1, initial=np.inf),
            "longitudinal_acceleration": world.ego.acceleration,
            "lateral_acceleration": across,
            "combined_acceleration": np.hypot(world.ego.acceleration, across),
            "jerk": world.jerk,
            "time_to_collision": time_to_collision(world.ego, world.others, self.scene),
        }

    def faults(self, world: World) -> Bools:
        """Return a mask (N,) of the rows whose ego state is not finite."""
        ego = world.ego
        return ~(np.isfinite(ego.x) & np.isfinite(ego.y) & np.isfinite(ego.heading) & np.isfinite(ego.speed))


class ScriptedTraffic:
    """Trajectories of V other vehicles, fixed before the run and the same for every particle."""

    def __init__(self, vehicles: tuple[VehicleConfig, ...], road: Road, dt: float) -> None:
        self.dt = dt
        self._line = road.line
        samples = [_samples(vehicle, road, dt) for vehicle in vehicles]
        self._last = np.array([len(x) - 1 for x, _, _, _ in samples], dtype=np.int64)
        longest = int(self._last.max(initial=0)) + 1
        self._table = np.zeros((4, longest, len(vehicles)))
        for v, series in enumerate(samples):
            for row, values in enumerate(series):
                self._table[row, : len(values), v] = values
                self._table[row, len(values) :, v] = values[-1]
        self._change = np.zeros_like(self._table[3])
        self._change[1:] = np.diff(self._table[3], axis=0) / dt

    def at(self, step: NDArray[np.int64]) -> Vehicles:
        """Return vehicles (N, V) at each particle's step; at constant velocity after a trajectory's end."""
        row = np.minimum(step[:, None], self._last)
        x, y, heading, speed = (self._table[k][row, np.arange(row.shape[1])] for k in range(4))
        beyond = (step[:, None] - row) * self.dt
        change = np.where(beyond > 0.0, 0.0, self._change[row, np.arange(row.shape[1])])
        along, across = beyond * speed * np.cos(heading), beyond * speed * np.sin(heading)
        if self._line is None:
            return Vehicles(x + along, y + across, heading, speed, change)
        return Vehicles(self._line.advance(x, y + 0.5 * across, along), y + across, heading, speed, change)


@lru_cache(maxsize=256)
def _samples(vehicle: VehicleConfig, road: Road, dt: float) -> tuple[Floats, Floats, Floats, Floats]:
    if vehicle.drive is None:
        start = (vehicle.x, vehicle.y, vehicle.heading, vehicle.speed)
        x, y, heading, speed = (np.array([value]) for value in start)
        return x, y, heading, speed
    from avrare_mpc.trajectory import plan_trajectory

    planned = plan_trajectory(vehicle.drive, vehicle.x, vehicle.y, vehicle.speed, vehicle.heading, road, dt)
    x = planned.x if road.line is None else _along_bends(road.line, planned.x, planned.y)
    return x, planned.y, planned.heading, planned.speed


def _along_bends(line: ReferenceLine, x: Floats, y: Floats) -> Floats:
    # Stations of a way planned on a straight road, whose steps have their lengths where the vehicle drives.
    stations = x[:1]
    for step in range(len(x) - 1):
        aside = 0.5 * (y[step : step + 1] + y[step + 1 : step + 2])
        stations = np.append(
            stations, line.advance(stations[-1:], aside, x[step + 1 : step + 2] - x[step : step + 1])
        )
    return stations


def build_road(config: RoadConfig) -> Road:
    """Return the road of the options."""
    pieces = tuple(
        Piece(
            piece.length,
            piece.curvature,
            piece.curvature if piece.end_curvature is None else piece.end_curvature,
        )
        for piece in config.line
    )
    return Road(
        config.lane_centres,
        config.lane_width,
        config.access_ramp,
        config.begin,
        config.end,
        CurvedLine(pieces) if pieces else None,
        _lanes(config),
        opposing=tuple(sorted(set(config.opposing))),
        broad_markings=config.broad_markings,
    )


def _lanes(config: RoadConfig) -> tuple[Lane, ...]:
    if not config.lane_spans:
        return ()
    spans = {span.lane: (span.begin, span.end) for span in config.lane_spans}
    lanes, half = [], 0.5 * config.lane_width
    for lane, y in enumerate(config.lane_centres):
        begin, end = spans.get(lane, (None, None))
        stations = np.array([-ENDLESS if begin is None else begin, ENDLESS if end is None else end])
        lanes.append(Lane(stations, np.full(2, y - half), np.full(2, y + half)))
    return tuple(lanes)
