"""Recorded drives of any format with vehicles, opened once for any number of egos."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Protocol

from avrare.base.errors import UsageError
from avrare.driving import Road
from avrare.results.recordings import Recording
from avrare_recordings.formats.commonroad import open_commonroad, read_network
from avrare_recordings.formats.commonroad_2024 import SUFFIX, is_companion
from avrare_recordings.formats.csv_recording import open_csv
from avrare_recordings.formats.drone_recording import is_drone_recording, open_drone_recording


class Drives(Protocol):
    """Vehicles of one file, any of which can be the ego."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the vehicles that can be the ego."""

    def recording(self, ego: str) -> Recording:
        """Return the drive of one ego; UsageError if there is none."""


def open_drives(path: str, road: Road | None = None, network: str | None = None) -> Drives:
    """Open a CommonRoad file, a CSV file of vehicles, or the tracks of a recording from the air.

    Args:
        path: The file.
        road: Road of drives without lanes that can be read.
        network: CommonRoad file whose lanelets, signs and lights are those of a recording without lanes.
    """
    if path.lower().endswith((".xml", SUFFIX)):
        return open_commonroad(path, road)
    if is_drone_recording(Path(path)):
        return open_drone_recording(path, road, read_network(network) if network is not None else None)
    return open_csv(path, road)


def check_lanes(recording: Recording, road: Road | None) -> None:
    """Raise the ``UsageError`` of lanes that were given for a drive with lanes of its own."""
    if road is not None and recording.scene is not None and recording.scene.road is not road:
        raise UsageError(f"{recording.source}: it has lanes of its own", "leave out --lanes")


def list_recordings(folder: Path) -> Sequence[Path]:
    """Return the CommonRoad and CSV files of a folder and those below, but no files of metadata, in order."""
    paths = [path for path in sorted(folder.rglob("*")) if path.suffix.lower() in (".xml", SUFFIX, ".csv")]
    files = [
        path
        for path in paths
        if path.is_file() and not path.name.endswith(("_tracksMeta.csv", "_recordingMeta.csv"))
    ]
    files = [path for path in files if not is_companion(path)]
    if not files:
        hint = "recordings end in .xml, .pb or .csv"
        raise UsageError(f"{folder}: no run folder, and no recording in it", hint)
    return files
