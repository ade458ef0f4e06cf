"""Results of a study that are kept with the repository, as an archive of lines."""

from __future__ import annotations

import argparse
import json
import shutil
import zipfile
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any


def unpack(archive: Path, results: Path) -> None:
    """Make the results folder, with the kept results where it is new."""
    if not results.exists() and archive.exists():
        shutil.unpack_archive(archive, results)
    results.mkdir(parents=True, exist_ok=True)


def pack(archive: Path, results: Path, pattern: str = "*.jsonl") -> None:
    """Keep the results whose file names match; the same lines give the same bits."""
    archive.parent.mkdir(parents=True, exist_ok=True)
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as whole:
        for file in sorted(results.glob(pattern)):
            whole.writestr(zipfile.ZipInfo(file.name), file.read_bytes(), zipfile.ZIP_DEFLATED, 9)


def add(file: Path, outcome: Any) -> None:
    """Append a result, a dataclass, as a line of its file, and print it."""
    text = json.dumps(asdict(outcome))
    with file.open("a", encoding="utf-8") as whole:
        print(text, file=whole, flush=True)
    print(file.stem, text, flush=True)


def lines(file: Path) -> Iterator[dict[str, Any]]:
    """Yield the fields of each line of a file of results; a torn line is left out."""
    for line in file.read_text(encoding="utf-8").splitlines() if file.exists() else ():
        try:
            yield json.loads(line)
        except json.JSONDecodeError:
            continue


def parser(text: str | None, archive: Path, results: Path, cell: str) -> argparse.ArgumentParser:
    """Return the arguments of a study whose cells are run seed by seed.

    Args:
        text: Docstring of the program.
        archive: Kept results.
        results: Folder of the results.
        cell: Example of a cell's name.
    """
    found = argparse.ArgumentParser(description=text, formatter_class=argparse.RawTextHelpFormatter)
    found.add_argument("--minutes", type=float, default=60.0, help="begin no result after these")
    found.add_argument("--seeds", type=int, default=20, help="results of a cell")
    found.add_argument("--only", default="", help=f"cells whose name holds this, as {cell}")
    found.add_argument("--results", type=Path, default=results)
    found.add_argument("--report-only", action="store_true")
    found.add_argument("--keep", action="store_true", help=f"write the results into {archive.name}")
    return found
