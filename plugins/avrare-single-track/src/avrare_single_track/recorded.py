"""Simulator: a CommonRoad scene, its planning problem as the ego and its obstacles as recorded."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from avrare.base.errors import UsageError
from avrare.driving import Road, Scene, Vehicles, World
from avrare.driving.lanes import ENDLESS, lane_overlap
from avrare.protocols import Bools, Floats, Signals
from avrare.results.recordings import VehicleTrack
from avrare_single_track.config import DriverConfig, SingleTrackConfig, VehicleConfig
from avrare_single_track.file_config import HandedOverConfig, RecordedConfig, check_ego
from avrare_single_track.recorded_files import read_scene
from avrare_single_track.simulator import ScriptedTraffic, SingleTrack, TrackWorld


def build(config: RecordedConfig, scene: Scene | None = None) -> RecordedScene:
    """Build the simulator of a scenario.

    Raises:
        UsageError: The file cannot be read, or the planning problem is not on a lane.
    """
    return RecordedScene(config)


class RecordedScene(SingleTrack):
    """Single-track ego among obstacles that repeat their recorded motion, whatever the ego does."""

    def __init__(self, config: RecordedConfig) -> None:
        self._path = path = str(config.file)
        scene = read_scene(config)
        ego = check_ego(path, {**scene.body, **config.ego})
        super().__init__(SingleTrackConfig(dt=scene.dt, ego=ego, after_impact=config.after_impact))
        self.last, self.lights = scene.last, scene.lights
        self.traffic = ReplayedTraffic([track.fill_gaps(scene.dt) for track in scene.others], scene.last + 1)
        self.scene = Scene(
            scene.dt,
            scene.road,
            self.config.ego.length,
            self.config.ego.width,
            tuple(f"v{track.name}" for track in scene.others),
            np.array([track.length for track in scene.others]),
            np.array([track.width for track in scene.others]),
            np.array([_moves(track) for track in scene.others], dtype=bool),
        )
        if config.drivers is not None:
            self._hand_over(path, config.drivers, scene.others)

    def _hand_over(self, path: str, drivers: HandedOverConfig, tracks: list[VehicleTrack]) -> None:
        if not has_constant_lanes(self.scene.road):
            raise UsageError(
                f"{path}: drivers need lanes of constant widths and offsets", "leave out `drivers`"
            )
        able = [
            track.name
            for track, moving in zip(tracks, self.scene.moving, strict=True)
            if moving and track.present[0] and _is_along_a_lane(self.scene.road, *track.states[:3, 0])
        ]
        chosen = [str(name) for name in drivers.vehicles] or able
        if wrong := [name for name in chosen if name not in able]:
            why = "is not there at the start, does not move, or is not along a lane of the ego's road"
            text = f"{path}: obstacle {wrong[0]} {why}"
            raise UsageError(text, f"drivers.vehicles may name: {', '.join(able) or 'none'}")
        options = drivers.model_dump(exclude={"vehicles"})
        vehicles = []
        for track in tracks:
            x, y, heading, speed = track.states[:4, np.argmax(track.present)].tolist()
            driver = {**options, "desired_speed": max(float(np.nanmax(track.states[3])), 1.0)}
            vehicles.append(
                VehicleConfig(
                    name=f"v{track.name}",
                    x=x,
                    y=y,
                    speed=max(speed, 0.0),
                    heading=heading,
                    length=track.length,
                    width=track.width,
                    driver=DriverConfig(**driver) if track.name in chosen else None,
                )
            )
        scene = replace(self.scene, road=continue_lanes(self.scene.road))
        self.react(tuple(vehicles), scene)

    def signals(self, world: TrackWorld) -> Signals:
        """Return the signals of ``single_track``, and the colours ``light_k`` (N,) of lights on the way."""
        step = np.minimum(world.step, self.last)
        return {**super().signals(world), **{name: colours[step] for name, colours in self.lights.items()}}

    def check_steps(self, steps: int) -> None:
        """Raise the ``UsageError`` of a rollout that is longer than the recording."""
        if steps > self.last:
            raise UsageError(
                f"{self._path}: the recording ends {self.last * self.dt:g} s after the start, at step "
                f"{self.last}, but a rollout has {steps} steps",
                f"set `steps: {self.last}`, or fewer",
            )

    def faults(self, world: World) -> Bools:
        """Return a mask (N,) of the rows without a finite ego or beyond the end of the recording."""
        return super().faults(world) | (world.step > self.last)


def _moves(track: VehicleTrack) -> bool:
    return bool(np.abs(track.states[3][track.present]).max() > 0.01)  # it is not parked [m/s]


def has_constant_lanes(road: Road) -> bool:
    """Return whether no lane moves aside by more than 0.3 m."""
    largest_shift = 0.3  # most that a border of a lane may move aside where drivers keep to it [m]
    return all(np.ptp(border) < largest_shift for lane in road.lanes for border in (lane.right, lane.left))


def continue_lanes(road: Road) -> Road:
    """Return the road with the lanes that reach its ends going on: where a map ends nobody has to stop."""
    lanes = []
    reach = 1.0  # a through lane may lack so much at either end of the road [m]
    for lane in road.lanes:
        stations = lane.stations.copy()
        stations[0] = -ENDLESS if stations[0] <= road.begin + reach else stations[0]
        stations[-1] = ENDLESS if stations[-1] >= road.end - reach else stations[-1]
        lanes.append(replace(lane, stations=stations))
    return replace(road, lanes=tuple(lanes))


def _is_along_a_lane(road: Road, x: float, y: float, heading: float) -> bool:
    place = np.array(x), np.array(y), np.array(0.0), np.array(0.0)
    largest_angle = 0.25 * np.pi  # largest angle between a driver that is handed over and its lane [rad]
    return abs(np.cos(heading)) > np.cos(largest_angle) and bool((lane_overlap(road, *place) > 0.0).any())


class ReplayedTraffic(ScriptedTraffic):
    """Recorded states of V obstacles; one that is not there at a step is far away, in no lane."""

    def __init__(self, tracks: list[dict[str, Floats]], samples: int) -> None:
        names = ("x", "y", "heading", "speed", "acceleration")
        self._recorded: Mapping[str, Floats] = {
            name: np.array([track[name] for track in tracks], dtype=np.float64)
            .reshape(len(tracks), samples)
            .T
            for name in names
        }

    def at(self, step: NDArray[np.int64]) -> Vehicles:
        """Return vehicles (N, V) at each particle's step, at most the last one."""
        return Vehicles(*(values[np.minimum(step, len(values) - 1)] for values in self._recorded.values()))
