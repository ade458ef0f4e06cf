"""Executor with worker processes on this machine, each with its own pipe: the death of one harms no other.

Workers share no queue and no lock: one that is killed in the midst of its answer leaves an end of file.
"""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
import socket
import sys
import threading
from contextlib import suppress
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection
from typing import Any

from avrare.base.errors import UsageError
from avrare.rollout.child_process import describe_exit
from avrare.rollout.executors.work import ExecutorConfig, Task, Work
from avrare.rollout.executors.worker_pool import WorkerLost, WorkerPool

HINT = "define the system, its parts and the score at the top level of a module, or use workers=1"
_UNGUARDED = 97
"""Exit code of a worker whose import of the script began another estimate with workers."""
_OUT_OF_MEMORY = 98
"""Exit code of a worker whose chunk needs more memory than there is."""


class WorkerProcess:
    """Spawned process that runs one task at a time; ``work`` is pickled."""

    def __init__(self, work: bytes) -> None:
        context = multiprocessing.get_context("spawn")
        self._connection, theirs = context.Pipe()
        self._process = context.Process(target=_serve, args=(theirs,))
        try:
            _start_without_interrupt(self._process)
        finally:
            theirs.close()  # from now on the death of the process is an end of file
        self._work: bytes | None = work  # sent with the first chunk: a lost process must not block the start
        self._stopped = 0
        self._hanging_up = threading.Lock()  # the number of a closed pipe may be that of another worker's

    def prepare(self) -> None:
        """Send the work, and wait until the process has read it."""
        if self._work is not None:
            work, self._work = self._work, None
            self._ask(work)

    def run(self, task: Task) -> Any:
        """Return the outcome of a task, or raise its exception; raise ``WorkerLost`` at its death."""
        return unpack(self._ask(pickle.dumps(task)))

    def _ask(self, question: bytes) -> bytes:
        try:
            self._connection.send_bytes(question)
            return self._connection.recv_bytes()
        except (OSError, EOFError):
            self._process.join(1.0)  # it may take a second to leave its exit code
            exit_code = self._process.exitcode
            if exit_code == _UNGUARDED:
                raise UsageError(
                    "worker processes import this script, and would run it again",
                    'put the call under `if __name__ == "__main__":`, or use workers=1',
                ) from None
            self.kill()
            blameless = exit_code in (None, -signal.SIGKILL, _OUT_OF_MEMORY)
            raise WorkerLost(_describe_end(exit_code), blameless=blameless) from None

    def look(self) -> None:
        """Kill the process if it stays stopped, and hang up if it is dead."""
        self._stopped = self._stopped + 1 if _is_stopped(self._process.pid) else 0
        # looks in a row that find a worker stopped (SIGSTOP) before it is given up; Ctrl-Z stops the parent
        # too
        most_stopped_looks = 10
        if self._stopped >= most_stopped_looks or self._process.exitcode is not None:
            self.kill()

    def kill(self) -> None:
        """Kill the process; a thread in ``run`` gets an end of file, even if a child still has the pipe."""
        self._process.kill()
        with (
            self._hanging_up,
            suppress(OSError),
            socket.socket(fileno=os.dup(self._connection.fileno())) as pipe,
        ):
            pipe.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        """Wait until the process, which is idle or killed, has ended; kill one that does not."""
        with self._hanging_up:
            self._connection.close()
        self._process.join(10.0)
        self._process.kill()
        self._process.join()


def unpack(answer: bytes) -> object:
    """Return the outcome in an answer, or raise the exception in it."""
    outcome = pickle.loads(answer)
    if isinstance(outcome, BaseException):
        raise outcome
    return outcome


def exit_unguarded_worker() -> None:
    """End this process if it is a worker that still imports the script, which nothing guards."""
    if getattr(multiprocessing.current_process(), "_inheriting", False):
        os._exit(_UNGUARDED)


def _start_without_interrupt(process: multiprocessing.process.BaseProcess) -> None:
    # Processes inherit a blocked Ctrl-C, which is for the parent alone, from their first instruction on.
    if not hasattr(signal, "pthread_sigmask"):
        process.start()
        return
    resource_tracker.ensure_running()  # otherwise begun by the start, which would let Ctrl-C through again
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        process.start()
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _describe_end(exit_code: int | None) -> str:
    if exit_code is None:
        return "it does not react"
    return "out of memory" if exit_code == _OUT_OF_MEMORY else describe_exit(exit_code)


def _is_stopped(pid: int | None) -> bool:
    if pid is None or not hasattr(os, "waitid"):
        return False
    with suppress(ChildProcessError):
        return os.waitid(os.P_PID, pid, os.WSTOPPED | os.WNOHANG | os.WNOWAIT) is not None
    return False


def _serve(connection: Connection) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent decides what Ctrl-C means
    threading.Thread(target=_exit_with_parent, daemon=True).start()
    with suppress(EOFError, OSError):  # the parent has closed the pipe
        work = _read_work(connection.recv_bytes())
        connection.send_bytes(b"")  # ready
        while True:
            connection.send_bytes(pack(work, connection.recv()))


def _read_work(payload: bytes) -> object:
    try:
        return pickle.loads(payload)
    except Exception as error:
        return UsageError(f"a worker process cannot read the problem: {error}", HINT)


def pack(work: Any, chunk: Task) -> bytes:
    """Run a chunk and return the pickled outcome or exception."""
    try:
        return pickle.dumps(work if isinstance(work, UsageError) else work.run(chunk))
    except MemoryError:
        os._exit(_OUT_OF_MEMORY)  # the chunk is run again, by itself from the second time on
    except Exception as error:
        return _pickle_error(error)


def _pickle_error(error: Exception) -> bytes:
    try:
        content = pickle.dumps(error)
        pickle.loads(content)
    except Exception:  # an exception with arguments of its own
        return pickle.dumps(RuntimeError(f"{type(error).__name__}: {error}"))
    return content


def _exit_with_parent() -> None:
    # A parent that is killed cannot stop its workers, which would go on with their chunks.
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def build(config: ExecutorConfig, scene: object | None = None) -> ProcessExecutor:
    """Build the executor."""
    return ProcessExecutor(config.workers)


class ProcessExecutor(WorkerPool):
    """Executor that runs chunks in spawned processes of one thread each.

    The work is pickled once; a problem from a scenario is pickled as the scenario.
    """

    def open(self, work: Work) -> None:
        """Take the work; a process starts with its first task."""
        exit_unguarded_worker()
        self._payload = pickle_work(work)
        single_thread = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
        # Processes read these before any of our code runs in them.
        self._added_variables = [name for name in single_thread if name not in os.environ]
        os.environ.update(dict.fromkeys(self._added_variables, "1"))
        super().open(work)

    def start_worker(self) -> WorkerProcess:
        """Start a process."""
        return WorkerProcess(self._payload)

    def close(self) -> None:
        """Stop the processes without waiting for running chunks."""
        super().close()
        for name in self._added_variables:
            os.environ.pop(name, None)
        self._added_variables = []


def pickle_work(work: Work) -> bytes:
    """Pickle the work for a worker process."""
    try:
        payload = pickle.dumps(work)
    except Exception as error:
        raise UsageError(f"the problem cannot be sent to a worker process: {error}", HINT) from error
    main = sys.modules["__main__"]
    importable = main.__spec__ is not None or os.path.exists(getattr(main, "__file__", ""))
    if b"__main__" in payload and not importable:
        raise UsageError("the problem is defined in a session that a worker process cannot import", HINT)
    if hasattr(main, "__file__") and not importable:
        text = "worker processes import this script, and it is not a file that they can read"
        raise UsageError(text, "save it as a file, or use workers=1")
    return payload
