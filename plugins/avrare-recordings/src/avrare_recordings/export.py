"""Export of a replayed failure as a recording of another tool's format."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Literal

from avrare.analysis.failures.stored_replays import FailureReplay
from avrare.base.atomic_files import explain_file_errors, write_text
from avrare.base.errors import UsageError
from avrare.results.recordings.recording import Recording
from avrare.results.recordings.replayed_failure import record_rollout
from avrare.rollout.frames import extract_frames
from avrare_recordings.formats.commonroad import to_commonroad
from avrare_recordings.formats.csv_recording import csv_vehicle_names, to_csv
from avrare_recordings.formats.mcap_recording import write_mcap
from avrare_recordings.formats.rerun_recording import write_rerun

Format = Literal["csv", "commonroad", "mcap", "rerun"]


def export(replay: FailureReplay, path: str | os.PathLike[str], file_format: Format) -> list[str]:
    """Write the rollout of a replayed failure into a file.

    Args:
        replay: Result of ``avrare.replay``.
        path: File to write.
        file_format: ``csv`` for ``avrare monitor``, ``commonroad``, ``mcap`` for Foxglove, or ``rerun``.

    Returns:
        Sentences about vehicles that the file calls by another name.

    Raises:
        UsageError: The rollout ended before its first sample, or the file cannot be written.
        PluginError: A package that writes the format is not installed.
    """
    source = f"failure {replay.failure.id}"
    if not replay.rollout.signals:
        raise UsageError(f"{source}: ends with an error at the start: there is nothing to write")
    problem = replay.scenario.problem(replay.scenario.specifications)
    recording = record_rollout(problem, replay.rollout, source)
    file = Path(path)
    match file_format:
        case "csv":
            _write_text(file, to_csv(recording))
            return _list_new_names(recording)
        case "commonroad":
            _write_text(file, to_commonroad(recording, replay.scenario.name))
        case "mcap":
            write_mcap(file, recording, extract_frames(problem, replay.rollout))
        case "rerun":
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
