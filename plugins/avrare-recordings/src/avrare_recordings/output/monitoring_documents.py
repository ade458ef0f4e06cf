"""Documents of a scored recording: JSON, and robustness over time as CSV."""

from __future__ import annotations

import csv
import io
from pathlib import Path
from typing import Any

from avrare.analysis.monitor.cause_finder import DecisiveSample
from avrare.analysis.monitor.monitoring import MonitoringResult
from avrare.base.atomic_files import write_text
from avrare.estimation.result.result import finite
from avrare.results.recordings import Recording


def monitoring_document(result: MonitoringResult) -> dict[str, object]:
    """Return the result as plain data for JSON; infinities become null."""
    recording = result.recording
    content = {
        "schema": 1,
        "source": recording.source,
        "specification": result.name,
        "formula": result.formula,
        "dt": recording.dt,
        "samples": recording.samples,
        "verdict": "broken" if result.violated else "kept",
        "robustness": result.robustness,
        "first": _encode_decisive(recording, result.first),
        "worst": _encode_decisive(recording, result.worst),
        "excluded": list(result.excluded),
        "time": recording.times.tolist(),
        "prefix": result.prefix.tolist(),
        "violated": result.prefix_violated.tolist(),
        "body": None if result.body is None else result.body.tolist(),
    }
    return finite(content)


def _encode_decisive(recording: Recording, decisive: DecisiveSample | None) -> dict[str, object] | None:
    if decisive is None:
        return None
    return {
        "sample": decisive.sample,
        "time": recording.time(decisive.sample),
        "robustness": decisive.robustness,
        "vehicles": decisive.vehicles,
        "formula": decisive.formula,
        "value": decisive.value,
        "value_sample": decisive.formula_sample,
        "value_time": recording.time(decisive.formula_sample),
    }


def write_monitoring_csv(result: MonitoringResult, path: Path) -> None:
    """Write time, robustness so far, violation and body of every sample as CSV."""
    columns: dict[str, Any] = {
        "time": [f"{t:.9g}" for t in result.recording.times],
        "robustness": result.prefix.tolist(),
        "violated": [str(bool(x)).lower() for x in result.prefix_violated],
    }
    if result.body is not None:
        columns["body"] = result.body.tolist()
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(zip(*columns.values(), strict=True))
    write_text(path, text.getvalue())
