"""Output of commands: warnings, files, and folders that hold earlier results."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path

from avrare.base.atomic_files import ensure_writable, explain_file_errors, write_text
from avrare.base.errors import UsageError
from avrare.base.records import Answer
from avrare.base.visible_text import spell_controls
from avrare.estimation.result.result import finite


def say(*lines: str, error: bool = False) -> None:
    """Print lines, optionally on stderr; control characters in names are escaped."""
    for line in lines:
        print(spell_controls(line), file=sys.stderr if error else sys.stdout)


def print_warnings(warnings: Iterable[tuple[str, str | None]]) -> None:
    """Print (message, hint) pairs on stderr, each pair once."""
    for message, hint in dict.fromkeys(warnings):
        say(f"warning: {message}" + (f"\nhint: {hint}" if hint else ""), error=True)


def ensure_files(names: Mapping[str, str | None]) -> None:
    """Raise a ``UsageError`` for files, by option, that could not be written when the run is over."""
    for option, name in names.items():
        if name and Path(name).is_dir():
            raise UsageError(f"{name}: is a folder, not a file", f"choose another {option}")
        if name:
            ensure_writable(Path(name).parent, option)


def write_file(path: Path | str, text: str, hint: str) -> None:
    """Write a text file, or raise a ``UsageError`` with this hint."""
    with explain_file_errors(f"{path}: cannot write", hint):
        write_text(Path(path), text)


def write_files(folder: Path, files: Mapping[str, str]) -> None:
    """Write text files, by name, into the folder of ``--out``."""
    with explain_file_errors(f"{folder}: cannot write", "choose another --out"):
        folder.mkdir(parents=True, exist_ok=True)
        for name, text in files.items():
            write_text(folder / name, text)


def show_or_write(
    args: argparse.Namespace, file: str, content: Mapping[str, object], answers: Sequence[Answer]
) -> None:
    """Write ``content`` as ``file`` into the folder of ``--out``, and show it or the answers."""
    if args.out is not None:
        write_files(Path(args.out), {file: json.dumps(finite(content), indent=2) + "\n"})
    with suppress(BrokenPipeError):  # `| head -1`: the answer is written, and no checkpoint stays
        show(args, content, answers)
        if args.out is not None and not args.json and not args.quiet:
            say(f"written: {Path(args.out) / file}")


def show(args: argparse.Namespace, content: Mapping[str, object], answers: Sequence[Answer]) -> None:
    """Print ``content`` (``--json``), or the answers in words: of each the first line alone if quiet."""
    if args.json:
        print(json.dumps(finite(content)))
    for answer in () if args.json else answers:
        say(*answer.lines()[: 1 if args.quiet else None])


def print_notes(args: argparse.Namespace, *lines: str) -> None:
    """Print additional lines: none in quiet mode, on stderr if the answer is JSON."""
    if not args.quiet:
        say(*lines, error=args.json)


def can_draw() -> bool:
    """Return whether matplotlib is installed; print a note if it is not."""
    from avrare.output.plots import has_matplotlib

    if not has_matplotlib():
        print("no pictures: matplotlib is not installed; pip install 'avrare[plot]'", file=sys.stderr)
    return has_matplotlib()


def find_resumed_folder(args: argparse.Namespace, begins: bool = True) -> Path | None:
    """Return the folder in which ``--resume`` continues; a note follows where a command ``begins`` there."""
    if not args.resume:
        return None
    if args.out is None:
        raise UsageError("--resume requires --out", "name the folder of the interrupted command: --out DIR")
    from avrare.results.run_folder import refuse_links

    folder = Path(args.out)
    if folder.exists() and not folder.is_dir():
        raise UsageError(f"--out {folder}: is not a folder", "name the interrupted one, or a new one")
    refuse_links(folder.rglob("*"))
    if begins and (not folder.is_dir() or not any(folder.iterdir())):
        say(f"{folder}: nothing to resume there yet: this is the beginning", error=True)
    return folder


UNFINISHED = "unfinished"
"""File in a folder of results that a command has begun to write; what lies beside it may be replaced."""


def refuse_overwrite(out: Path, summary: str, names: Sequence[str], resume: bool = False) -> None:
    """Refuse a folder that holds ``summary``, a result of a scenario, or an interrupted run.

    Several scenarios have their own folders in ``out``, which need not exist; the result of one alone, in
    ``out`` itself, would be taken for theirs. A folder that a killed command has left unfinished is taken,
    and to ``resume`` one with an interrupted run.
    """
    from avrare.estimation.loop.checkpoint import FOLDER, Checkpoint, read_index, resume_hint

    hint = "choose another folder, or remove it" if resume else "choose another --out, or remove it"
    if not resume and read_index(out / FOLDER) is not None and Checkpoint(out / FOLDER, {}).chunks:
        raise UsageError(f"{out}: contains an interrupted run", f"{resume_hint(out)}; else {hint}")
    if (out / UNFINISHED).exists():
        return
    folders = [out, *(out / name for name in names if len(names) > 1)]
    for path in (out / summary, *(folder / "result.json" for folder in folders)):
        if path.exists():
            raise UsageError(f"{path}: contains the result of an earlier command", hint)
