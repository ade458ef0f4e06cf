"""Recording of a rollout for the Rerun viewer: the messages of ``mcap_recording`` as Rerun's archetypes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from avrare.base.atomic_files import explain_file_errors
from avrare.base.errors import PluginError
from avrare.results.recordings import Recording
from avrare.rollout.replay import Frame
from avrare_recordings.formats.mcap_recording import SIGNALS, list_messages


def write_rerun(path: Path, recording: Recording, frames: Sequence[Frame]) -> None:
    """Write a rollout as ``.rrd``; ``frames`` is empty for a simulator without vehicles.

    Raises:
        PluginError: The package rerun-sdk is not installed.
        UsageError: The file cannot be written.
    """
    try:
        import rerun
    except ImportError:
        raise PluginError(f"{path}: needs rerun-sdk", "pip install 'avrare-recordings[rerun]'") from None
    with explain_file_errors(f"{path}: cannot write", "choose another file"):
        path.open("wb").close()  # rerun itself tells of a folder that is missing in a warning only
    stream = rerun.RecordingStream("avrare")
    stream.save(str(path))
    shown: dict[str, set[str]] = {}
    for step, topic, schema, content in list_messages(recording, frames):
        stream.set_time("rollout", duration=step * recording.dt)
        if schema == SIGNALS:
            for name, value in content.items():
                if value is not None:
                    stream.log(["signals", name], rerun.Scalars(value))
            continue
        present = {entity["id"] for entity in content["entities"]}
        for name in shown.get(topic, set()) - present:
            stream.log([topic.strip("/"), name], rerun.Clear(recursive=False))
        shown[topic] = present
        for entity in content["entities"]:
            for archetype in _translate(rerun, entity):
                stream.log([topic.strip("/"), entity["id"]], archetype, static=topic == "/road")
    stream.disconnect()


def _translate(rerun: Any, entity: Mapping[str, Any]) -> list[Any]:
    archetypes = []
    if cubes := entity["cubes"]:
        archetypes.append(
            rerun.Boxes3D(
                centers=[_xyz(shape["pose"]["position"]) for shape in cubes],
                sizes=[_xyz(shape["size"]) for shape in cubes],
                quaternions=[[shape["pose"]["orientation"][axis] for axis in "xyzw"] for shape in cubes],
                colors=[_rgba(shape) for shape in cubes],
                labels=[entity["id"]] * len(cubes),
            )
        )
    if spheres := entity["spheres"]:
        archetypes.append(
            rerun.Points3D(
                [_xyz(shape["pose"]["position"]) for shape in spheres],
                colors=[_rgba(shape) for shape in spheres],
                radii=[0.5 * shape["size"]["x"] for shape in spheres],
            )
        )
    if lines := entity["lines"]:
        archetypes.append(
            rerun.LineStrips3D(
                [[_xyz(point) for point in shape["points"]] for shape in lines],
                colors=[_rgba(shape) for shape in lines],
                radii=[0.5 * shape["thickness"] for shape in lines],
            )
        )
    return archetypes


def _xyz(values: Mapping[str, float]) -> list[float]:
    return [values[axis] for axis in "xyz"]


def _rgba(shape: Mapping[str, Any]) -> list[int]:
    return [round(255 * shape["color"][channel]) for channel in "rgba"]
