"""First runs of a system in a child process, so that a native crash there does not end the program.

A kind of system that has run in this process runs here; any other is tried in a forked child first, which has
the system without sending it, but none of its connections. A child that answers decides. One that raises,
hangs on a lock that was held at the fork, or cannot send its answer decides nothing: the function runs here.
"""

from __future__ import annotations

import ctypes
import faulthandler
import os
import pickle
import re
import signal
import sys
import sysconfig
import time
import warnings
from collections.abc import Callable
from contextlib import suppress
from itertools import islice
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from pathlib import Path
from types import CodeType, FunctionType
from typing import NoReturn, TypeVar

from avrare.base.errors import AvrareError, ExitCode
from avrare.protocols import Adapted

_CHILD_SECONDS = 20.0
"""Time that a child has for its answer."""
_IDLE_SECONDS = 1.5
"""Time without work after which a child hangs; so will the next one, and none is forked any more."""
_PARTS_DEPTH, _MAX_PARTS = 3, 1000
"""How deep, and how many, parts of a system are looked at to tell its kind."""
_may_fork = sys.platform == "linux"
"""False where a fork is not to be had, or the system's own libraries forbid it, and once a child has hung."""

_LIBRARIES = tuple(
    f"{folder}{os.sep}"
    for folder in (*map(sysconfig.get_path, ("stdlib", "purelib", "platlib")), Path(__file__).parents[1])
)
"""Folders of the standard library, of installed packages and of this one."""

T = TypeVar("T")
Kind = frozenset[type | CodeType | str]
_KINDS_RUN_HERE: set[Kind] = set()


class SystemCrashed(AvrareError):
    """A system that ends the process in which it runs."""

    exit_code = ExitCode.ROLLOUT_ERRORS


def run_guarded(purpose: str, system: object, function: Callable[[], T]) -> T:
    """Return the result of a function that runs a system.

    Args:
        purpose: The run in words, such as "the probe before the estimate".
        system: The system.
        function: The function; it may run twice, or in another process.

    Raises:
        SystemCrashed: The system ends its process.
    """
    if not _may_fork or _kind_of(system) in _KINDS_RUN_HERE or sys.gettrace() is not None:  # a debugger
        return function()
    with open(os.memfd_create("stack"), "r+b") as stack:
        answer, exit_code = _fork(function, system, stack.fileno())
        if exit_code is not None:
            stack.seek(0)
            place = _find_place(stack.read().decode(errors="replace"))
            raise SystemCrashed(
                f"the system ended its process ({describe_exit(exit_code)}) in {purpose}{place}",
                "mend that part of the system; `python -X faulthandler` shows the calls that lead there",
            )
    if answer:
        return pickle.loads(answer)  # type: ignore[no-any-return]
    run_here(system)
    return function()


def run_here(system: object) -> None:
    """Mark a system as running in this process from now on: its crash would end the process anyway."""
    _KINDS_RUN_HERE.add(_kind_of(system))


def describe_exit(code: int) -> str:
    """Return the exit code of a process in words: "SIGSEGV", "exit code 1"."""
    if code == -signal.SIGKILL:
        return "killed, or out of memory"
    with suppress(ValueError):
        if code < 0:
            return signal.Signals(-code).name
    return f"exit code {code}"


def _kind_of(system: object) -> Kind:
    """Return the classes, functions and texts of a system and of its parts."""
    kind: set[type | CodeType | str] = set()
    parts, count = [system], 0
    for _ in range(_PARTS_DEPTH):
        inner: list[object] = []
        for part in parts[: max(_MAX_PARTS - count, 0)]:
            part = part.part if isinstance(part, Adapted) else part
            if isinstance(part, str):
                kind.add(part)
            elif isinstance(part, FunctionType):
                kind.add(part.__code__)
            elif isinstance(part, dict):
                inner += islice(part.values(), _MAX_PARTS)
            elif isinstance(part, list | tuple):
                inner += part[:_MAX_PARTS]
            elif type(part).__module__ != "builtins":
                kind.add(type(part))
                inner += getattr(part, "__dict__", {}).values()
        parts, count = inner, count + len(parts)
    return frozenset(kind)


def _fork(function: Callable[[], object], system: object, stack: int) -> tuple[bytes, int | None]:
    """Return the answer of a child, empty without one, and then the exit code with which it died."""
    global _may_fork
    ours, theirs = Pipe(duplex=False)
    with ours:
        _flush_output()  # or the child would print it, too
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # there may be threads: a child that misses one hangs
            try:
                child = os.fork()
            except OSError:  # no memory for it, or too many processes
                return b"", None
        if child == 0:
            run_here(system)
            _answer(function, theirs, stack)
        theirs.close()
        try:
            if _wait(ours, child):
                return ours.recv_bytes(), None
            hangs = os.waitid(os.P_PID, child, os.WEXITED | os.WNOHANG | os.WNOWAIT) is None
            _may_fork = _may_fork and not hangs
        except EOFError:
            hangs = False
        finally:
            exit_code = _end(child)
    return b"", None if hangs else exit_code


def _wait(connection: Connection, child: int) -> bool:
    """Return whether a child has answered or died, rather than hung."""
    end, work, idle = time.monotonic() + _CHILD_SECONDS, "", 0.0
    poll = 0.1
    while time.monotonic() < end and idle < _IDLE_SECONDS:
        if connection.poll(poll):
            return True
        before, work = work, _read_work(child)
        idle = idle + poll if work == before else 0.0
    return False


def _read_work(child: int) -> str:
    """Return the processor time of a child, in user and kernel mode; empty once it has ended."""
    with suppress(OSError):
        return " ".join(Path(f"/proc/{child}/stat").read_text().rpartition(")")[2].split()[11:13])
    return ""


def _close_connections(result_pipe: Connection) -> None:
    """Close the sockets and pipes that a child shares with its parent, whose other ends would advance."""
    for name in os.listdir("/proc/self/fd"):
        number = int(name)
        with suppress(OSError):
            is_connection = os.readlink(f"/proc/self/fd/{name}").startswith(("socket:", "pipe:"))
            if is_connection and number > 2 and number != result_pipe.fileno():
                os.close(number)


def _answer(function: Callable[[], object], connection: Connection, stack: int) -> NoReturn:
    try:
        os.setpgid(0, 0)  # what the system starts ends with the child, and Ctrl-C is for the parent
        ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG
        _close_connections(connection)
        faulthandler.disable()  # or it would not take signals back that a library has taken
        faulthandler.enable(stack, all_threads=False)
        answer = b""
        with suppress(BaseException), warnings.catch_warnings():
            warnings.simplefilter("ignore")  # those of the rollouts that count are shown
            answer = pickle.dumps(function())
        _flush_output()
        connection.send_bytes(answer)
    finally:
        os._exit(0)


def _end(child: int) -> int:
    """Kill a child and all that it has started; return its exit code, a signal as a negative number."""
    for kill in (os.killpg, os.kill):
        with suppress(OSError):
            kill(child, signal.SIGKILL)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def _flush_output() -> None:
    for stream in (sys.stdout, sys.stderr):
        with suppress(AttributeError, OSError, ValueError):  # there is none, or it is closed
            stream.flush()


def _find_place(stack: str) -> str:
    """Return the newest call of a dumped stack, preferably one in the user's code."""
    calls = re.findall(r'File "(.*)", line (\d+) in (.*)', stack)
    of_user = [call for call in calls if not call[0].startswith(_LIBRARIES)]
    return ", at {}:{} in {}".format(*(of_user or calls)[0]) if calls else ""
