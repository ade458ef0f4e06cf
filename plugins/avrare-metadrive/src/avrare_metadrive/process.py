"""A thing that lives in a process of its own, and copies of it by ``fork``.

The processes hang on their sockets alone: one whose owner has closed it, or has died, ends by itself.
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
"""Sets keep their order from process to process, and only one thread runs: fork copies no other."""


class Process:
    """The owner's side; the process ends when this is dropped.

    Args:
        connection: To the process.
    """

    def __init__(self, connection: Connection[Any, Any]) -> None:
        self._connection = connection

    @property
    def closed(self) -> bool:
        """Whether it has ended, as far as is known: it answered no more, or nobody waited for its answer."""
        return self._connection.closed

    def call(self, name: str, *arguments: Any) -> Any:
        """What the method ``name`` of the thing returns.

        Raises:
            RuntimeError: It raised something, or the process has ended.
        """
        return self._ask(name, arguments)

    def fork(self) -> Process:
        """A process whose thing stands where this one stands now.

        Raises:
            RuntimeError: There can be no more processes, or this one has ended.
        """
        ours, theirs = Pipe()
        try:
            self._ask("fork", (), theirs.fileno())
        finally:
            theirs.close()
        return Process(ours)

    def _ask(self, name: str, arguments: tuple[Any, ...], handle: int | None = None) -> Any:
        try:
            self._connection.send((name, arguments))
            if handle is not None:
                send_handle(self._connection, handle, None)
            good, value = self._connection.recv()
        except (EOFError, OSError) as error:
            self._connection.close()
            raise RuntimeError(f"the process of the world has ended in {name}: {error}") from None
        except BaseException:  # an interrupt: the answer would be taken for that to the next question
            self._connection.close()
            raise
        if not good:
            raise RuntimeError(value)
        return value


class First(Process):
    """A new Python, in which a thing is made.

    Args:
        module: Run as a program, with the number of a file descriptor as its argument; calls ``serve``.
    """

    def __init__(self, module: str) -> None:
        ours, theirs = Pipe()
        super().__init__(ours)
        # A session of its own: an interrupt is for the owner alone, who may want to finish first. -P: what
        # lies in the current folder is not taken for a package.
        process = subprocess.Popen(
            [sys.executable, "-P", "-m", module, str(theirs.fileno())], pass_fds=[theirs.fileno()],
            env=os.environ | _ENVIRONMENT, start_new_session=True,
            stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        theirs.close()
        weakref.finalize(self, _end, ours, process)


def _end(connection: Connection[Any, Any], process: subprocess.Popen[bytes]) -> None:
    connection.close()
    process.kill()
    process.wait()


def serve(connection: Connection[Any, Any], thing: Any) -> None:
    """The process's side: call methods of ``thing``, and fork, until the owner is gone."""
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # nobody waits for copies
    while True:
        try:
            name, arguments = connection.recv()
            if name == "fork":
                connection = _forked(connection)
                continue
        except (EOFError, OSError):
            os._exit(0)  # what the simulator would do at its exit is the first process's to do
        try:
            answer = True, getattr(thing, name)(*arguments)
        except Exception as error:
            answer = False, f"{type(error).__name__}: {error}"
        connection.send(answer)


def _forked(connection: Connection[Any, Any]) -> Connection[Any, Any]:
    """The connection that this process serves from now on: its own, or in the copy the copy's."""
    theirs: Connection[Any, Any] = Connection(recv_handle(connection))
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
