"""Document of rules on many recorded drives: a row for every drive as CSV."""

from __future__ import annotations

import csv
import io
from dataclasses import fields
from pathlib import Path

from avrare.base.atomic_files import write_text
from avrare.base.visible_text import escape_cell
from avrare_recordings.batch import BatchResult, DriveScore


def write_batch_csv(result: BatchResult, path: Path) -> None:
    """Write a row for every drive and rule."""
    names = [field.name for field in fields(DriveScore)]
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(names)
    for score in result.scores:
        values = [getattr(score, name) for name in names]
        writer.writerow([escape_cell(value) if isinstance(value, str) else repr(value) for value in values])
    write_text(path, text.getvalue())
