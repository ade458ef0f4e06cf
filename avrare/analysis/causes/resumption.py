"""Checkpoint of an analysis that runs tapes: after a kill the same command goes on from there."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from avrare.base.errors import Interrupted
from avrare.estimation.loop.checkpoint import FOLDER, Checkpoint, FileJournal
from avrare.results.run import Run
from avrare.results.run_folder import refuse_links

OpenJournal = Callable[[str], FileJournal | None]
"""Gives the journal of one of the runners of tapes by its name; None where nothing is kept."""


@contextmanager
def keep_outcomes(out: Path | None, command: str, task: Mapping[str, object]) -> Iterator[OpenJournal]:
    """Keep finished rollouts in a checkpoint in ``out`` until the block ends without an error.

    Args:
        out: Folder of the command's result; None: nothing is kept.
        command: Name of the command, of which each folder has one checkpoint.
        task: All that decides the rollouts and their order, as plain JSON data.

    Raises:
        UsageError: The checkpoint in ``out`` belongs to another task, or another process uses it.
        Interrupted: Ctrl-C; finished rollouts are kept.
    """
    if out is None:
        yield lambda name: None
        return
    folder = out / f"{command}-{FOLDER}"
    refuse_links([folder, *folder.rglob("*")])
    with Checkpoint.open(folder, task).held() as checkpoint:
        try:
            yield checkpoint.journal
        except KeyboardInterrupt as error:
            text = f"interrupted; finished rollouts are saved in {folder}"
            raise Interrupted(text, "the same command goes on from there") from error
        checkpoint.remove()


def identify_run(run: Run) -> str:
    """Return the identity of a run's result, in which its files have their checksums."""
    return hashlib.sha256(json.dumps(run.to_dict(), sort_keys=True).encode()).hexdigest()[:32]
