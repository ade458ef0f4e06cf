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
from avrare.results.recordings.recording import ABSENT, FIELDS, Recording, VehicleTrack
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
    kept = [one for name, one in drives.obstacles.items() if int(name) not in config.without]
    steps = [int(one.steps.max()) for one in kept if len(one.steps)]
    first, last = int(start.steps[0]), max(steps, default=0)
    samples = last - first + 1
    if samples < 2:
        raise UsageError(f"{path}: no obstacle is recorded after the planning problem begins")
    for one in kept:
        here = one.states[:2, (one.steps == first) | (not len(one.steps))] - start.states[:2]
        if (np.hypot(*here) < 0.5 * one.width).any():
            text = f"{path}: obstacle {one.name} is where the ego starts"
            warn_once(f"{text}: if it is the ego itself, leave it out by `without: [{one.name}]`")
    others = [one.track(first, samples, angle, road.line) for one in kept]
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
        known = ", ".join(drives.names[:20])
        raise UsageError(f"{path}: there is no moving vehicle {vehicle}", f"choose one of: {known}")
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


def _leave_out(found: RecordedFile, without: Sequence[int] = ()) -> RecordedFile:
    # Those that are never there, too. Ways through intersections have the indices of those who take them.
    names = set(map(str, without))
    kept = [k for k, one in enumerate(found.others) if one.present.any() and one.name not in names]
    at = {k: index for index, k in enumerate(kept)}
    crossings = tuple(
        replace(one, users=None if one.users is None else tuple(at[k] for k in one.users if k in at))
        for one in found.road.crossings
    )
    others = [found.others[k] for k in kept]
    return replace(found, others=others, road=replace(found.road, crossings=crossings))


def _resample(path: str, found: RecordedFile, dt: float) -> RecordedFile:
    # Linear between the recorded samples; what was not there at both of them is not there.
    old = np.arange(found.last + 1) * found.dt
    last = int(np.floor(old[-1] / dt + 1e-9))
    if last < 1:
        raise UsageError(f"{path}: the recording lasts {old[-1]:g} s", f"`dt` is {dt:g} s")
    new = np.arange(last + 1) * dt
    before = np.minimum((new / found.dt + 1e-9).astype(np.int64), found.last)
    after = np.minimum(before + (new > old[before] + 1e-9), found.last)
    others = []
    for track in found.others:
        here, states = track.present, np.full((len(FIELDS), last + 1), np.nan)
        for row, values in enumerate(track.states):
            known = np.unwrap(values[here]) if FIELDS[row] == "heading" else values[here]
            states[row] = np.interp(new, old[here], known)
        others.append(replace(track, present=here[before] & here[after], states=states))
    lights: Mapping[str, Any] = {name: values[before] for name, values in found.lights.items()}
    return replace(found, dt=dt, others=others, last=last, lights=lights)


def _check_names(path: str, config: RecordedConfig, known: set[str]) -> None:
    if unknown := {str(one) for one in config.without} - known:
        raise UsageError(f"{path}: there is no obstacle {min(unknown)}", "look at `without`")


def _check_start(path: str, road: Road, x: float, y: float) -> None:
    right, left = lane_borders(road, np.array(x))
    if not (right <= y).any() or not (y <= left).any():
        raise UsageError(f"{path}: the ego does not start on the way along `route`", "look at `route`")
