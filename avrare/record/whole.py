"""Files that are written whole or not at all."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

from avrare.errors import UsageError


def ready(folder: Path, option: str) -> None:
    """Make a folder and see that it takes files: asked before work that would be lost if it did not.

    Args:
        folder: Where the results go.
        option: What named it, for the hint.

    Raises:
        UsageError: It cannot be made or written to.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        text = f"{folder}: cannot write: {error.strerror or error}"
        raise UsageError(text, f"choose another {option}") from error


def write_text(path: Path, text: str) -> None:
    """Write a text file whole or not at all, in UTF-8.

    Raises:
        OSError: The folder cannot be written to.
    """
    write_whole(path, text.encode("utf-8"))


def write_whole(path: Path, content: bytes, durably: bool = False) -> None:
    """Write a file whole or not at all.

    Args:
        path: Of the file.
        content: All of it.
        durably: Return only when it would be there after a loss of power.

    Raises:
        OSError: The folder cannot be written to.
    """
    handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(content)
            if durably:
                file.flush()
                os.fsync(file.fileno())
        os.chmod(temporary, 0o644)
        os.replace(temporary, path)
    except BaseException:
        os.unlink(temporary)
        raise
    if durably and hasattr(os, "O_DIRECTORY"):  # the name must be on the disk as well
        folder = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)
