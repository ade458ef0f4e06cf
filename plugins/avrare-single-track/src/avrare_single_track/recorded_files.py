"""Recorded scenes of files: a planning problem's start, or the drive of a vehicle that the ego stands for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from avrare.base.errors import UsageError
from avrare.driving import Road
from avrare.driving.lanes import lane_borders
from avrare.protocols import Floats
from avrare.results.recordings import ABSENT, FIELDS, Recording, VehicleTrack
from avrare_recordings.formats.commonroad import open_problem, warn_once
from avrare_recordings.formats.drives import open_drives
from avrare_recordings.formats.drone_recording import is_drone_recording
from avrare_recordings.roads.plane_drives import PlaneDrives
from avrare_single_track.file_config import RecordedConfig

_POSE = ("x", "y", "heading", "speed")


@dataclass(frozen=True)
class RecordedFile:
    """Scene of a file, from the ego's start on.

    Attributes:
        dt: Step [s].
        road: Road of the ego.
        body: Start of the ego, and its size where a vehicle was recorded in its place.
        others: The other vehicles.
        last: Last recorded step.
        lights: Signals of traffic lights (T,).
    """

    dt: float
    road: Road
    body: Mapping[str, float]
    others: list[VehicleTrack]
    last: int
    lights: Mapping[str, Floats]


def read_scene(config: RecordedConfig) -> RecordedFile:
    """Read the scene of a configuration.

    Raises:
        UsageError: The file cannot be read, or the ego is on no lane.
    """
    scene = _read_problem(config) if config.vehicle is None else _read_drive(config, str(config.vehicle))
    scene = _leave_out(scene, config.without)
    return scene if config.dt is None else _leave_out(_resample(str(config.file), scene, config.dt))


def _read_problem(config: RecordedConfig) -> RecordedFile:
    path = str(config.file)
    drives, start = open_problem(path, config.problem)
    guide = drives.lead(start, config.route)
    road, angle = drives.find_road(guide)
    _check_names(path, config, set(drives.obstacles))
    obstacles = [obstacle for name, obstacle in drives.obstacles.items() if int(name) not in config.without]
    steps = [int(obstacle.steps.max()) for obstacle in obstacles if len(obstacle.steps)]
    first, last = int(start.steps[0]), max(steps, default=0)
    samples = last - first + 1
    if samples < 2:
        raise UsageError(f"{path}: no obstacle is recorded after the planning problem begins")
    for obstacle in obstacles:
        here = obstacle.states[:2, (obstacle.steps == first) | (not len(obstacle.steps))] - start.states[:2]
        if (np.hypot(*here) < 0.5 * obstacle.width).any():
            text = f"{path}: obstacle {obstacle.name} is where the ego starts"
            warn_once(f"{text}: if it is the ego itself, leave it out by `without: [{obstacle.name}]`")
    others = [obstacle.track(first, samples, angle, road.line) for obstacle in obstacles]
    road, lights = drives.add_rules(road, guide, [track.name for track in others], first, samples)
    pose = start.track(first, 1, angle, road.line).states[:4, 0]
    if config.route:
        _check_start(path, road, *pose[:2])
    body = dict(zip(_POSE, pose.tolist(), strict=True))
    return RecordedFile(drives.dt, road, body, others, last - first, lights)


def _read_drive(config: RecordedConfig, vehicle: str) -> RecordedFile:
    path = str(config.file)
    drives = open_drives(path, network=None if config.network is None else str(config.network))
    if config.network is not None and not (
        is_drone_recording(Path(path)) and isinstance(drives, PlaneDrives)
    ):
        raise UsageError(f"{path}: `network` is of a recording in the format of inD", "leave it out")
    if vehicle not in drives.names:
        names = ", ".join(drives.names[:20])
        raise UsageError(f"{path}: there is no moving vehicle {vehicle}", f"choose one of: {names}")
    recording = drives.recording(vehicle)
    scene, signals = recording.scene, recording.signals
    if scene is None:
        raise UsageError(f"{path}: the recording has no lanes", "take one of CommonRoad, highD or inD")
    if recording.samples < 2:
        raise UsageError(f"{path}: vehicle {vehicle} is recorded at one step only")
    _check_names(path, config, set(recording.names))
    others = [_track(recording, k) for k in range(len(recording.names))]
    body = {name: float(signals[f"ego_{name}"][0]) for name in _POSE}
    body |= {"length": scene.ego_length, "width": scene.ego_width}
    lights = {name: values for name, values in signals.items() if name.startswith("light_")}
    return RecordedFile(recording.dt, scene.road, body, others, recording.samples - 1, lights)


def _track(recording: Recording, k: int) -> VehicleTrack:
    assert recording.scene is not None
    states = np.stack([recording.signals[f"others_{field}"][:, k] for field in FIELDS])
    sizes = float(recording.scene.lengths[k]), float(recording.scene.widths[k])
    return VehicleTrack(recording.names[k], *sizes, states[0] != ABSENT["x"], states)


def _leave_out(scene: RecordedFile, without: Sequence[int] = ()) -> RecordedFile:
    # Those that are never there, too. Ways through intersections have the indices of those who take them.
    names = set(map(str, without))
    present = [k for k, entry in enumerate(scene.others) if entry.present.any() and entry.name not in names]
    at = {k: index for index, k in enumerate(present)}
    crossings = tuple(
        replace(entry, users=None if entry.users is None else tuple(at[k] for k in entry.users if k in at))
        for entry in scene.road.crossings
    )
    others = [scene.others[k] for k in present]
    return replace(scene, others=others, road=replace(scene.road, crossings=crossings))


def _resample(path: str, scene: RecordedFile, dt: float) -> RecordedFile:
    # Linear between the recorded samples; what was not there at both of them is not there.
    old = np.arange(scene.last + 1) * scene.dt
    last = int(np.floor(old[-1] / dt + 1e-9))
    if last < 1:
        raise UsageError(f"{path}: the recording lasts {old[-1]:g} s", f"`dt` is {dt:g} s")
    new = np.arange(last + 1) * dt
    before = np.minimum((new / scene.dt + 1e-9).astype(np.int64), scene.last)
    after = np.minimum(before + (new > old[before] + 1e-9), scene.last)
    others = []
    for track in scene.others:
        here, states = track.present, np.full((len(FIELDS), last + 1), np.nan)
        for row, values in enumerate(track.states):
            values_present = np.unwrap(values[here]) if FIELDS[row] == "heading" else values[here]
            states[row] = np.interp(new, old[here], values_present)
        others.append(replace(track, present=here[before] & here[after], states=states))
    lights: Mapping[str, Any] = {name: values[before] for name, values in scene.lights.items()}
    return replace(scene, dt=dt, others=others, last=last, lights=lights)


def _check_names(path: str, config: RecordedConfig, names: set[str]) -> None:
    if unknown := {str(number) for number in config.without} - names:
        raise UsageError(f"{path}: there is no obstacle {min(unknown)}", "look at `without`")


def _check_start(path: str, road: Road, x: float, y: float) -> None:
    right, left = lane_borders(road, np.array(x))
    if not (right <= y).any() or not (y <= left).any():
        raise UsageError(f"{path}: the ego does not start on the way along `route`", "look at `route`")
