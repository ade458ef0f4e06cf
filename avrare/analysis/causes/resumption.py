"""Checkpoint of an analysis that runs tapes, from which it resumes after a kill."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from avrare.base.errors import Interrupted, UsageError
from avrare.estimation.loop.checkpoint import FOLDER, Checkpoint, FileJournal, read_index
from avrare.results.run import Run
from avrare.results.run_folder import refuse_links

OpenJournal = Callable[[str], FileJournal | None]
"""Gives the journal of one of the runners of tapes by its name; None where nothing is kept."""


@contextmanager
def keep_outcomes(
    out: Path | None, command: str, task: Mapping[str, object], resume: bool = False
) -> Iterator[OpenJournal]:
    """Keep finished rollouts in a checkpoint in ``out`` until the block ends without an error.

    Args:
        out: Folder of the command's result; None: nothing is kept.
        command: Name of the command, of which each folder has one checkpoint.
        task: All that decides the rollouts and their order, as plain JSON data.
        resume: Continue from the checkpoint that an interrupted command has left.

    Raises:
        UsageError: There is a checkpoint in ``out`` and ``resume`` is false, it belongs to another task, or
            another process uses it.
        Interrupted: Ctrl-C; finished rollouts are kept.
    """
    if out is None:
        yield lambda name: None
        return
    folder = out / f"{command}-{FOLDER}"
    refuse_links([folder, *folder.rglob("*")])
    resume_hint = "--resume (in Python: resume=True)"
    if not resume and read_index(folder) is not None and Checkpoint(folder, {}).chunks:
        text = f"{folder}: an interrupted command has left its rollouts there"
        raise UsageError(text, f"resume with the same command and {resume_hint}; else remove that folder")
    with Checkpoint.open(folder, task).hold() as checkpoint:
        try:
            yield checkpoint.journal
        except KeyboardInterrupt as error:
            text = f"interrupted; finished rollouts are saved in {folder}"
            raise Interrupted(text, f"resume with the same command and {resume_hint}") from error
        checkpoint.remove()


def identify_run(run: Run) -> str:
    """Return the identity of a run's result, in which its files have their checksums."""
    return hashlib.sha256(json.dumps(run.to_dict(), sort_keys=True).encode()).hexdigest()[:32]
