"""Export of a replayed failure as a recording of another tool's format."""

from __future__ import annotations

import os
from pathlib import Path

from avrare.analysis.failures.stored_replays import FailureReplay
from avrare.base.atomic_files import explain_file_errors, write_text
from avrare.base.errors import UsageError
from avrare.results.recordings import Recording, record_rollout
from avrare.rollout.replay import extract_frames
from avrare_recordings.formats.commonroad import to_commonroad
from avrare_recordings.formats.csv_recording import csv_vehicle_names, to_csv
from avrare_recordings.formats.mcap_recording import write_mcap
from avrare_recordings.formats.rerun_recording import write_rerun


def export(replay: FailureReplay, path: str | os.PathLike[str]) -> list[str]:
    """Write the rollout of a replayed failure into a file, whose suffix chooses the format.

    Args:
        replay: Result of ``avrare.replay``.
        path: File to write: ``.csv`` for ``avrare monitor``, ``.xml`` (CommonRoad), ``.mcap`` (Foxglove) or
            ``.rrd`` (Rerun).

    Returns:
        Sentences about vehicles that the file calls by another name.

    Raises:
        UsageError: The suffix names no format, the rollout ended before its first sample, or the file cannot
            be written.
        PluginError: A package that writes the format is not installed.
    """
    file = Path(path)
    suffixes = (".csv", ".xml", ".mcap", ".rrd")
    if file.suffix not in suffixes:
        raise UsageError(f"{path}: its suffix is of no format", f"one of {', '.join(suffixes)}")
    source = f"failure {replay.failure.id}"
    if not replay.rollout.signals:
        raise UsageError(f"{source}: ends with an error at the start: there is nothing to write")
    problem = replay.scenario.problem(replay.scenario.specifications)
    recording = record_rollout(problem, replay.rollout, source)
    match file.suffix:
        case ".csv":
            _write_text(file, to_csv(recording))
            return _list_new_names(recording)
        case ".xml":
            _write_text(file, to_commonroad(recording, replay.scenario.name))
        case ".mcap":
            write_mcap(file, recording, extract_frames(problem, replay.rollout))
        case ".rrd":
            write_rerun(file, recording, extract_frames(problem, replay.rollout))
    return []


def _list_new_names(recording: Recording) -> list[str]:
    names = zip(recording.names, csv_vehicle_names(recording.names), strict=True)
    return [
        f"the vehicle {name!r} is written as {written!r}: "
        + (f"{name!r} is the ego" if name == "ego" else "a spreadsheet or terminal would obey it")
        for name, written in names
        if written != name
    ]


def _write_text(path: Path, text: str) -> None:
    with explain_file_errors(f"{path}: cannot write", "choose another file"):
        write_text(path, text)
