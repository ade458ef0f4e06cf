"""Only one process at a time: a lock that goes with the process, however it ends."""

from __future__ import annotations

import errno
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

try:
    import fcntl
except ImportError:  # Windows has no such locks; there nobody is kept out
    fcntl = None  # type: ignore[assignment]


_NO_LOCKS = (errno.ENOLCK, errno.ENOTSUP, errno.ENOSYS)


class Taken(Exception):
    """Somebody else has the lock."""


@contextmanager
def alone(path: Path) -> Iterator[None]:
    """Hold the lock of a file while entered; a file system that knows no locks keeps nobody out.

    Args:
        path: A file that is there.

    Raises:
        OSError: It cannot be opened.
        Taken: Another process, or another holder in this one, has it.
    """
    with path.open("r+b") as file:
        if fcntl is not None:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise Taken from None
            except OSError as error:
                if error.errno not in _NO_LOCKS:
                    raise
        yield
