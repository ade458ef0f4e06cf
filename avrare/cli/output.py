"""Output of commands: warnings, files, and folders that hold earlier results."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

from avrare.base.errors import UsageError


def print_warnings(warnings: Iterable[tuple[str, str | None]]) -> None:
    """Print (message, hint) pairs on stderr, each pair once."""
    for message, hint in dict.fromkeys(warnings):
        print(f"warning: {message}" + (f"\nhint: {hint}" if hint else ""), file=sys.stderr)


@contextmanager
def write_errors(path: Path | str, hint: str) -> Iterator[None]:
    """Turn errors of writing to ``path`` into a ``UsageError`` with a hint."""
    try:
        yield
    except OSError as error:
        raise UsageError(f"{path}: cannot write: {error.strerror or error}", hint) from error


def write_files(folder: Path, files: Mapping[str, str]) -> None:
    """Write text files, by name, into the folder of ``--out``.

    Raises:
        UsageError: The folder cannot be written to.
    """
    from avrare.base.files import write_text

    with write_errors(folder, "choose another --out"):
        folder.mkdir(parents=True, exist_ok=True)
        for name, text in files.items():
            write_text(folder / name, text)


def can_draw() -> bool:
    """Return whether matplotlib is installed; print a note if it is not."""
    from avrare.report.plots.figure import has_matplotlib

    if not has_matplotlib():
        print("no pictures: matplotlib is not installed; pip install 'avrare[plot]'", file=sys.stderr)
    return has_matplotlib()


def refuse_overwrite(out: Path, summary: str, names: Sequence[str]) -> None:
    """Refuse a folder with results of an earlier command, before anything runs.

    Args:
        out: The folder; it need not exist.
        summary: Name of the file that the command writes into it.
        names: Names of the scenarios; several scenarios have their own folders in ``out``.

    Raises:
        UsageError: ``out`` contains ``summary``, a result of a scenario, or an interrupted run.
    """
    from avrare.estimation.checkpoint import FOLDER, Checkpoint, read_index

    hint = "choose another --out, or remove it"
    if read_index(out / FOLDER) is not None and Checkpoint(out / FOLDER, {}).chunks:
        command = shlex.join(["avrare", "run", "--resume", str(out)])
        raise UsageError(f"{out}: contains an interrupted run", f"resume it with {command}; else {hint}")
    folders = [out / name for name in names] if len(names) > 1 else [out]
    for path in (out / summary, *(folder / "result.json" for folder in folders)):
        if path.exists():
            raise UsageError(f"{path}: contains the result of an earlier command", hint)
