"""Recordings from CommonRoad XML files, read with the package ``commonroad-io``."""

from __future__ import annotations

import importlib
import math
from typing import Any

import numpy as np

from avrare.driving import Road
from avrare.errors import PluginError, UsageError
from avrare.protocols import Floats
from avrare.record.trace import FIELDS, Recording, Track, assemble
from avrare.record.trace_lanes import Lanes, rotate, straight_lanes


def read_commonroad(path: str, ego: str | None, road: Road | None = None) -> Recording:
    """Read the obstacles of a scenario as vehicles, one of them as the ego.

    The lanes are those of the lanelets; x runs along them. Accelerations are the changes of speed.

    Args:
        path: The XML file.
        ego: Id of the obstacle that rules are for.
        road: Lanes to use in place of the file's, in its own frame.

    Raises:
        UsageError: The file, the ego or the road cannot be used.
        PluginError: ``commonroad-io`` is not installed.
    """
    scenario = _open(path)
    moving = {str(obstacle.obstacle_id): obstacle for obstacle in scenario.dynamic_obstacles}
    if ego not in moving:
        known = ", ".join(sorted(moving, key=int)) or "none"
        text = "choose the ego" if ego is None else f"there is no moving obstacle {ego!r}"
        raise UsageError(f"{path}: {text}", f"choose it with --ego; there are: {known}")
    lanes = straight_lanes(path, scenario.lanelet_network.lanelets) if road is None else Lanes(road, 0.0)
    steps = [int(state.time_step) for state in _states(path, moving[ego])]
    first, samples = min(steps), max(steps) - min(steps) + 1
    tracks = {
        str(obstacle.obstacle_id): _track(path, obstacle, first, samples, lanes.angle)
        for obstacle in scenario.obstacles
    }
    if not tracks[ego].present.all():
        raise UsageError(f"{path}: obstacle {ego} has gaps in time", "the ego needs a state at every step")
    others = [track for name, track in tracks.items() if name != ego and track.present.any()]
    dt = float(scenario.dt)
    return assemble(path, dt, dt * first, tracks[ego], others, lanes.road)


def _open(path: str) -> Any:
    try:
        reader = importlib.import_module("commonroad.common.file_reader")
    except ImportError as error:
        text = f"{path}: CommonRoad files need the package commonroad-io"
        raise PluginError(text, "pip install 'avrare[commonroad]'") from error
    try:
        open(path, "rb").close()
        scenario, _ = reader.CommonRoadFileReader(path).open()
    except FileNotFoundError:
        raise UsageError(f"{path}: no such file") from None
    except Exception as error:  # the reader raises whatever its XML parser or its assertions raise
        reason = " ".join(str(error).split()) or type(error).__name__
        raise UsageError(f"{path}: not a CommonRoad scenario: {reason[:200]}") from None
    return scenario


def _states(path: str, obstacle: Any) -> list[Any]:
    prediction = getattr(obstacle, "prediction", None)
    if prediction is None:
        return [obstacle.initial_state]
    if not hasattr(prediction, "trajectory"):
        raise UsageError(
            f"{path}: obstacle {obstacle.obstacle_id} has no trajectory", "sets are not supported"
        )
    return [obstacle.initial_state, *prediction.trajectory.state_list]


def _track(path: str, obstacle: Any, first: int, samples: int, angle: float) -> Track:
    """One obstacle from step ``first`` on, turned by minus ``angle`` into the road's frame."""
    present, states = np.zeros(samples, dtype=bool), np.full((len(FIELDS), samples), np.nan)
    if str(obstacle.obstacle_role.value) == "static":
        present[:] = True
        states[:] = np.array([*_pose(path, obstacle, obstacle.initial_state, angle)[:3], 0.0, 0.0])[:, None]
    else:
        for state in _states(path, obstacle):
            k = int(state.time_step) - first
            if 0 <= k < samples:
                present[k] = True
                states[:4, k] = _pose(path, obstacle, state, angle)
    length, width = _size(path, obstacle)
    return Track(str(obstacle.obstacle_id), length, width, present, states)


def _pose(path: str, obstacle: Any, state: Any, angle: float) -> Floats:
    """x, y, heading and speed of a state."""
    position: Any = getattr(state, "position", None)
    heading: Any = getattr(state, "orientation", None)
    speed: Any = getattr(state, "velocity", None)
    if str(obstacle.obstacle_role.value) == "static":
        speed = 0.0
    if not isinstance(position, np.ndarray) or not _is_number(heading) or not _is_number(speed):
        text = f"obstacle {obstacle.obstacle_id} has no exact position, orientation and velocity"
        raise UsageError(f"{path}: {text} at step {state.time_step}")
    x, y = rotate(position, angle)
    turned = math.remainder(float(heading) - angle, 2.0 * math.pi)
    return np.array([x, y, turned, float(speed)])


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float, np.number)) and math.isfinite(value)


def _size(path: str, obstacle: Any) -> tuple[float, float]:
    """Length and width; a circle counts as the square around it."""
    shape = obstacle.obstacle_shape
    if hasattr(shape, "length") and hasattr(shape, "width"):
        return float(shape.length), float(shape.width)
    if hasattr(shape, "radius"):
        return 2.0 * float(shape.radius), 2.0 * float(shape.radius)
    kind = type(shape).__name__
    raise UsageError(
        f"{path}: obstacle {obstacle.obstacle_id} is a {kind}", "only rectangles and circles have a size"
    )
