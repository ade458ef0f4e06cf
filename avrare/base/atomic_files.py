"""Atomic writes, and a lock that only one process holds at a time."""

from __future__ import annotations

import errno
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from avrare.base.errors import UsageError

try:
    import fcntl
except ImportError:  # Windows has no such locks: nobody is kept out there
    fcntl = None  # type: ignore[assignment]


class LockHeld(Exception):
    """The lock is held by another process, or by another holder in this one."""


def ensure_writable(folder: Path, option: str) -> None:
    """Make a folder of results and check that it can be written to; ``option`` of the command named it."""
    with explain_file_errors(f"{folder}: cannot write", f"choose another {option}"):
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass


@contextmanager
def explain_file_errors(
    message: str, hint: str | None = None, kind: type[UsageError] = UsageError
) -> Iterator[None]:
    """Turn an ``OSError`` into an error of this kind, with the reason at the end of its message."""
    try:
        yield
    except OSError as error:
        raise kind(f"{message}: {error.strerror or error}", hint) from error


def write_text(path: Path, text: str) -> None:
    """Write a text file in UTF-8, completely or not at all."""
    write_atomic(path, text.encode("utf-8"))


def write_atomic(path: Path, content: bytes, durable: bool = False) -> None:
    """Write a file completely or not at all; ``durable``: return once it would survive a loss of power."""
    handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(content)
            if durable:
                file.flush()
                os.fsync(file.fileno())
        os.chmod(temporary, 0o644)
        os.replace(temporary, path)
    except BaseException:
        os.unlink(temporary)
        raise
    if durable and hasattr(os, "O_DIRECTORY"):  # the name must be on the disk as well
        folder = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)


@contextmanager
def exclusive_lock(path: Path) -> Iterator[None]:
    """Hold the lock of an existing file, which ends with the process; raise ``LockHeld`` if another has it.

    A file system without locks keeps nobody out.
    """
    with path.open("r+b") as file:
        if fcntl is not None:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise LockHeld from None
            except OSError as error:
                if error.errno not in (errno.ENOLCK, errno.ENOTSUP, errno.ENOSYS):
                    raise
        yield
