"""Recording of a rollout as an MCAP file for Foxglove and other viewers.

Messages are JSON with Foxglove's schemas (https://docs.foxglove.dev/docs/visualization/message-schemas):
``/scene`` has the true boxes, ``/observations``, ``/tracks`` and ``/plan`` what the stack sees, estimates and
plans, ``/road`` the lanes, ``/signals`` all numbers by name. Time 0 is the start of the rollout.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from avrare.base.atomic_files import explain_file_errors
from avrare.base.errors import PluginError
from avrare.driving import Scene, Vehicles
from avrare.results.recordings import Recording
from avrare.rollout.replay import Frame, tabulate_signals

Entity = dict[str, list[dict[str, object]]]
"""Primitives of an entity by kind."""

_SCENE, SIGNALS = "foxglove.SceneUpdate", "avrare.Signals"
_HEIGHT = 1.5  # of a vehicle [m]
_COLOURS = {
    "ego": (0.11, 0.42, 0.66, 1.0),
    "moving": (0.42, 0.48, 0.56, 1.0),
    "parked": (0.69, 0.27, 0.24, 1.0),
    "seen": (0.88, 0.54, 0.12, 1.0),
    "track": (0.48, 0.25, 0.63, 1.0),
    "road": (0.6, 0.6, 0.6, 1.0),
}


def write_mcap(path: Path, recording: Recording, frames: Sequence[Frame]) -> None:
    """Write a rollout; ``frames`` is empty for a simulator without vehicles.

    Raises:
        PluginError: The package mcap is not installed.
        UsageError: The file cannot be written.
    """
    try:
        from mcap.writer import Writer
    except ImportError:
        raise PluginError(f"{path}: needs mcap", "pip install 'avrare-recordings[mcap]'") from None
    with explain_file_errors(f"{path}: cannot write", "choose another file"), path.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="", library="avrare")
        schemas = {
            name: writer.register_schema(name, "jsonschema", json.dumps(schema).encode())
            for name, schema in _describe(recording).items()
        }
        channels: dict[str, int] = {}
        for step, topic, schema, content in list_messages(recording, frames):
            if topic not in channels:
                channels[topic] = writer.register_channel(topic, "json", schemas[schema])
            time = round(1e9 * step * recording.dt)
            writer.add_message(channels[topic], time, json.dumps(content).encode(), time)
        writer.finish()


def _describe(recording: Recording) -> dict[str, dict[str, object]]:
    names, _ = tabulate_signals(recording.signals, recording.scene)
    array, number = {"type": "array", "items": {"type": "object"}}, {"type": ["number", "null"]}
    return {
        _SCENE: {
            "title": _SCENE,
            "type": "object",
            "properties": {"deletions": array, "entities": array},
        },
        SIGNALS: {
            "title": SIGNALS,
            "type": "object",
            "properties": dict.fromkeys(names, number),
        },
    }


def list_messages(
    recording: Recording, frames: Sequence[Frame]
) -> Iterator[tuple[int, str, str, dict[str, Any]]]:
    """Yield the step, topic, schema and content of every message."""
    names, values = tabulate_signals(recording.signals, recording.scene)
    for step, row in enumerate(values):
        finite = [float(x) if math.isfinite(x) else None for x in row]
        yield step, "/signals", SIGNALS, dict(zip(names, finite, strict=True))
    scene = recording.scene
    if scene is None:
        return
    if frames:
        yield 0, "/road", _SCENE, _update(0.0, {"road": {"lines": _list_lanes(scene)}})
    for frame in frames:
        time = frame.t * recording.dt
        for topic, entities in _list_entities(scene, frame).items():
            yield frame.t, topic, _SCENE, _update(time, entities)


def _list_entities(scene: Scene, frame: Frame) -> dict[str, dict[str, Entity]]:
    ego, others = frame.world.ego, frame.world.others
    boxes = {"ego": _box(ego, 0, scene.ego_length, scene.ego_width, "ego")}
    for v, name in enumerate(scene.names):
        kind = "moving" if scene.moving[v] else "parked"
        boxes[name] = _box(others, (0, v), scene.lengths[v], scene.widths[v], kind)
    topics = {"/scene": boxes}
    if frame.observation is not None:
        observation = frame.observation
        topics["/observations"] = {
            name: {"spheres": [_sphere(observation.x[0, v], observation.y[0, v])]}
            for v, name in enumerate(_pad(scene.names, observation.detected.shape[1], "ghost"))
            if observation.detected[0, v]
        }
    if frame.prediction is not None:
        x, y = np.asarray(frame.prediction.x[0]), np.asarray(frame.prediction.y[0])
        topics["/tracks"] = {
            name: {"lines": [_line(x[v], y[v], "track")]}
            for v, name in enumerate(_pad(scene.names, len(x), "track"))
            if np.isfinite(x[v]).all() and np.isfinite(y[v]).all()
        }
    if frame.plan is not None:
        topics["/plan"] = {"ego": {"lines": [_line(frame.plan[:, 0], frame.plan[:, 1], "ego")]}}
    return topics


def _pad(names: Sequence[str], count: int, more: str) -> list[str]:
    return [*names, *(f"{more} {k}" for k in range(1, count - len(names) + 1))]


def _box(vehicle: Vehicles, at: int | tuple[int, int], length: float, width: float, kind: str) -> Entity:
    x, y, heading = (float(np.asarray(getattr(vehicle, key))[at]) for key in ("x", "y", "heading"))
    size = {"x": float(length), "y": float(width), "z": _HEIGHT}
    cube: dict[str, object] = {
        "pose": _pose(x, y, 0.5 * _HEIGHT, heading),
        "size": size,
        "color": _colour(kind),
    }
    return {"cubes": [cube]}


def _sphere(x: float, y: float) -> dict[str, object]:
    size = {"x": 0.8, "y": 0.8, "z": 0.8}
    return {"pose": _pose(float(x), float(y), _HEIGHT), "size": size, "color": _colour("seen")}


def _line(x: Iterable[float], y: Iterable[float], kind: str, width: float = 0.15) -> dict[str, object]:
    points = [{"x": float(a), "y": float(b), "z": 0.05} for a, b in zip(x, y, strict=True)]
    return {
        "type": 0,
        "pose": _pose(0.0, 0.0),
        "thickness": width,
        "scale_invariant": False,
        "points": points,
        "color": _colour(kind),
        "colors": [],
        "indices": [],
    }


def _list_lanes(scene: Scene) -> list[dict[str, object]]:
    road, half = scene.road, 0.5 * scene.road.lane_width
    edges = sorted({round(centre + side * half, 3) for centre in road.lane_centres for side in (-1, 1)})
    return [_line((road.begin, road.end), (edge, edge), "road") for edge in edges]


def _pose(x: float, y: float, z: float = 0.0, heading: float = 0.0) -> dict[str, dict[str, float]]:
    turn = {"x": 0.0, "y": 0.0, "z": math.sin(0.5 * heading), "w": math.cos(0.5 * heading)}
    return {"position": {"x": x, "y": y, "z": z}, "orientation": turn}


def _colour(kind: str) -> dict[str, float]:
    return dict(zip("rgba", _COLOURS[kind], strict=True))


def _update(time: float, entities: Mapping[str, Entity]) -> dict[str, object]:
    nanoseconds = round(1e9 * time)
    stamp = {"sec": nanoseconds // 10**9, "nsec": nanoseconds % 10**9}
    primitive_kinds = ("arrows", "cubes", "spheres", "cylinders", "lines", "triangles", "texts", "models")
    return {
        # All entities of the topic go before those of this step appear: type 1 is ALL.
        "deletions": [{"timestamp": stamp, "type": 1, "id": ""}],
        "entities": [
            {
                "timestamp": stamp,
                "frame_id": "road",
                "id": name,
                "lifetime": {"sec": 0, "nsec": 0},
                "frame_locked": False,
                "metadata": [],
                **{kind: [] for kind in primitive_kinds},
                **primitives,
            }
            for name, primitives in entities.items()
        ],
    }
