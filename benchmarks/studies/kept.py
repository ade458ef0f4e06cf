"""Results of a study that are kept with the repository, as an archive of lines."""

from __future__ import annotations

import shutil
import zipfile
from pathlib import Path


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
