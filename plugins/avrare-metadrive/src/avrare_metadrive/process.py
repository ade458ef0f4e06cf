"""Objects in separate processes, copied by ``fork``.

A process ends when its socket is closed, that is when its owner drops it or dies.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import weakref
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from multiprocessing.reduction import recv_handle, send_handle
from typing import Any

_ENVIRONMENT = {"PYTHONHASHSEED": "0", "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
"""Equal order of sets in all processes, and a single thread: fork copies only one."""

Call = tuple[str, tuple[object, ...]]
"""Method and arguments."""
Answer = tuple[bool, object]
"""Whether the call succeeded, and its result or the message of its error."""


class Process:
    """Owner's side of a process, which ends when this object is dropped.

    Args:
        connection: Connection to the process.
    """

    def __init__(self, connection: Connection[Call, Answer]) -> None:
        self._connection = connection

    @property
    def closed(self) -> bool:
        """True if the process stopped answering, or a call was interrupted."""
        return self._connection.closed

    def call(self, name: str, *arguments: object) -> Any:
        """Call the method ``name`` of the object in the process.

        Raises:
            RuntimeError: The method raised an error, or the process has ended.
        """
        return self._ask(name, arguments)

    def fork(self) -> Process:
        """Return a copy of the process in its current state.

        Raises:
            RuntimeError: No more processes can be created, or this one has ended.
        """
        ours, theirs = Pipe()
        try:
            self._ask("fork", (), theirs.fileno())
        finally:
            theirs.close()
        return Process(ours)

    def _ask(self, name: str, arguments: tuple[object, ...], handle: int | None = None) -> object:
        try:
            self._connection.send((name, arguments))
            if handle is not None:
                send_handle(self._connection, handle, None)
            good, value = self._connection.recv()
        except (EOFError, OSError) as error:
            self._connection.close()
            raise RuntimeError(f"the process of the world has ended in {name}: {error}") from None
        except BaseException:  # an interrupt: the pending answer would be read as that of the next call
            self._connection.close()
            raise
        if not good:
            raise RuntimeError(value)
        return value


class RootProcess(Process):
    """New Python process.

    Args:
        module: Module to run with the number of a file descriptor as argument; it calls ``serve``.
    """

    def __init__(self, module: str) -> None:
        ours, theirs = Pipe()
        super().__init__(ours)
        # New session: an interrupt reaches only the owner, who may want to finish first.
        # -P: files in the current folder are not imported.
        process = subprocess.Popen(
            [sys.executable, "-P", "-m", module, str(theirs.fileno())],
            pass_fds=[theirs.fileno()],
            env=os.environ | _ENVIRONMENT,
            start_new_session=True,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        theirs.close()
        weakref.finalize(self, _end, ours, process)


def _end(connection: Connection[Call, Answer], process: subprocess.Popen[bytes]) -> None:
    connection.close()
    process.kill()
    process.wait()


def serve(connection: Connection[Answer, Call], target: object) -> None:
    """Serve calls of ``target``'s methods, and forks, until the owner is gone; runs in the process."""
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # nobody waits for copies
    while True:
        try:
            name, arguments = connection.recv()
            if name == "fork":
                connection = _fork(connection)
                continue
        except (EOFError, OSError):
            os._exit(0)  # no exit handlers: they belong to the root process
        try:
            answer = True, getattr(target, name)(*arguments)
        except Exception as error:
            answer = False, f"{type(error).__name__}: {error}"
        connection.send(answer)


def _fork(connection: Connection[Answer, Call]) -> Connection[Answer, Call]:
    """Fork; return the connection to serve from now on: its own, or in the copy the new one."""
    theirs: Connection[Answer, Call] = Connection(recv_handle(connection))
    try:
        copy = os.fork()
    except OSError as error:
        connection.send((False, f"no more processes: {error}"))
        theirs.close()
        return connection
    if copy == 0:
        connection.close()
        return theirs
    theirs.close()
    connection.send((True, None))
    return connection
