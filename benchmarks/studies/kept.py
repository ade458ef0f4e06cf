"""Results of a study that are kept with the repository, as an archive of lines."""

from __future__ import annotations

import json
import shutil
import zipfile
from collections.abc import Iterator
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


def lines(file: Path) -> Iterator[dict[str, Any]]:
    """Yield the fields of each line of a file of results; a torn line is left out."""
    for line in file.read_text(encoding="utf-8").splitlines() if file.exists() else ():
        try:
            yield json.loads(line)
        except json.JSONDecodeError:
            continue
