"""Atomic writes, and a lock that only one process holds at a time."""

from __future__ import annotations

import errno
import os
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from avrare.base.errors import UsageError

try:
    import fcntl
except ImportError:  # Windows has no such locks: nobody is kept out there
    fcntl = None  # type: ignore[assignment]

_OURS = "avrare_"
"""Mark in the names of temporary files: those of other programs are never removed."""


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
    """Write a file completely or not at all; ``durable``: return once it would survive a loss of power.

    Temporary files of processes that died are removed, unless ``durable``: there may be very many files.
    A device, such as ``/dev/stdout``, is written to and stays what it is.
    """
    if _is_device(path):
        path.write_bytes(content)
        return
    if not durable:
        remove_torn(path.parent)
    handle, temporary = _open_temporary(path)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(content)
            file.flush()
            if durable:
                os.fsync(handle)
            if fcntl is None:  # Windows renames no open file; elsewhere its lock says that it is in use
                file.close()
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


def _is_device(path: Path) -> bool:
    # Links elsewhere are replaced and not followed: a folder of somebody else may hold one
    try:
        mode = path.lstat().st_mode
    except OSError:
        return False
    return stat.S_ISCHR(mode) or (stat.S_ISLNK(mode) and path.is_relative_to("/dev"))


def remove_torn(folder: Path) -> None:
    """Remove the temporary files in a folder whose writers are dead, as their locks tell."""
    for temporary in folder.glob(f".*.{_OURS}*.tmp") if fcntl is not None else ():
        with suppress(OSError), temporary.open("rb") as file:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            temporary.unlink()


def _open_temporary(path: Path) -> tuple[int, str]:
    while True:
        handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.{_OURS}", suffix=".tmp")
        with suppress(OSError):  # a file system without locks: then nothing is ever removed
            if fcntl is not None:
                fcntl.flock(handle, fcntl.LOCK_EX)
        if os.fstat(handle).st_nlink or fcntl is None:
            return handle, temporary
        os.close(handle)  # removed by ``remove_torn`` before it was locked


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
