"""A folder for results that holds some already: they are not written over without a word."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path

from avrare.errors import UsageError


def refuse_former(out: Path, summary: str, names: Sequence[str]) -> None:
    """Refuse a folder with the results of an earlier command, asked before anything runs.

    Args:
        out: The folder; it need not exist.
        summary: Name of the file that the command writes into it.
        names: Of the scenarios, which have folders in it where there are several.

    Raises:
        UsageError: ``out`` holds ``summary``, a result of a scenario, or an interrupted run.
    """
    from avrare.record.checkpoint import FOLDER, Checkpoint, read_index

    hint = "choose another --out, or remove it"
    if read_index(out / FOLDER) is not None and Checkpoint(out / FOLDER, {}).chunks:
        goes_on = f"{shlex.join(['avrare', 'run', '--resume', str(out)])} goes on with it"
        raise UsageError(f"{out}: holds a run that was interrupted", f"{goes_on}; else {hint}")
    places = [out / name for name in names] if len(names) > 1 else [out]
    for path in (out / summary, *(place / "result.json" for place in places)):
        if path.exists():
            raise UsageError(f"{path}: holds the result of an earlier command", hint)
