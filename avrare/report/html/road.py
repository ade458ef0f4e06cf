"""What the animated top view reads: lanes, vehicles, observations, plan and predictions of a drive."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from avrare.driving import Scene
from avrare.report.html.drives import Drive
from avrare.report.picture import Frame

_MOST_NUMBERS = 60_000
"""Of plans and predictions; a longer drive is shown without them."""


def film(drive: Drive, marked: Sequence[str]) -> dict[str, Any]:
    """The drive as plain data; positions in metres to the centimetre.

    Args:
        drive: With frames or without.
        marked: Names of vehicles to point out.
    """
    assert drive.score is not None
    recording = drive.score.recording
    content: dict[str, Any] = {"dt": recording.dt, "samples": recording.samples}
    scene = recording.scene
    if scene is None or not drive.frames:
        return content
    content["road"] = _road(scene)
    content["ego"] = {"l": scene.ego_length, "w": scene.ego_width, **_path(drive.frames, "ego", 0)}
    content["others"] = [
        {
            "name": name,
            "l": float(scene.lengths[v]),
            "w": float(scene.widths[v]),
            "moving": bool(scene.moving[v]),
            "marked": name in marked,
            **_path(drive.frames, "others", (0, v)),
        }
        for v, name in enumerate(scene.names)
    ]
    content["seen"] = [_seen(frame, len(scene.names)) for frame in drive.frames]
    plans = [None if one.plan is None else _pairs(one.plan[:, :2]) for one in drive.frames]
    predictions = [_prediction(frame) for frame in drive.frames]
    if _count(plans) + _count(predictions) <= _MOST_NUMBERS:
        content |= {"plan": plans, "predicted": predictions}
    return content


def _road(scene: Scene) -> dict[str, Any]:
    road = scene.road
    return {"lanes": list(road.lane_centres), "width": road.lane_width, "ramp": list(road.access_ramp)}


def _path(frames: Sequence[Frame], who: str, at: Any) -> dict[str, list[float]]:
    vehicles = [getattr(frame.world, who) for frame in frames]
    return {
        key: [_round(getattr(one, field)[at], digits) for one in vehicles]
        for key, field, digits in (("x", "x", 2), ("y", "y", 2), ("h", "heading", 4), ("v", "speed", 2))
    }


def _seen(frame: Frame, vehicles: int) -> list[list[float] | int] | None:
    """Of each vehicle where it was seen, 0 where it was missed; None: nobody looked."""
    if frame.observation is None:
        return None
    seen = frame.observation
    return [
        [_round(seen.x[0, v]), _round(seen.y[0, v])] if seen.detected[0, v] else 0 for v in range(vehicles)
    ]


def _prediction(frame: Frame) -> list[list[list[float]]] | None:
    if frame.prediction is None:
        return None
    x, y = frame.prediction.x[0], frame.prediction.y[0]
    return [_pairs(np.stack(pair, axis=-1)) for pair in zip(x, y, strict=True)]


def _pairs(points: Any) -> list[list[float]]:
    return [[_round(x), _round(y)] for x, y in points]


def _count(entries: Sequence[Any]) -> int:
    return sum(int(np.size(entry)) for entry in entries if entry is not None)


def _round(value: Any, digits: int = 2) -> float:
    """JSON knows no NaN: a position that is none lies at the origin."""
    return round(float(np.nan_to_num(value)), digits)
