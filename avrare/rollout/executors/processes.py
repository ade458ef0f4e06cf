"""Executor with worker processes on this machine."""

from __future__ import annotations

import os
import pickle
import sys
import threading
from collections.abc import Iterable, Iterator
from concurrent.futures import Future
from queue import SimpleQueue
from typing import Any

from avrare.base.errors import UsageError
from avrare.rollout.executors.in_flight import Window, WorkerDied, WorkerLost
from avrare.rollout.executors.serial import ExecutorConfig
from avrare.rollout.executors.work import Executor, Task, Work
from avrare.rollout.executors.worker_process import HINT, WorkerProcess, exit_if_unguarded, unpack

__all__ = ["ProcessExecutor", "WorkerDied", "build"]

_ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
_IN_FLIGHT = 2
"""Chunks in flight for each worker: one running, one queued."""
_LOOK = 0.5
"""Seconds between two looks at the workers while the parent waits for an outcome."""


def build(config: ExecutorConfig, scene: object | None = None) -> ProcessExecutor:
    """Build the executor."""
    return ProcessExecutor(config.workers)


class ProcessExecutor(Executor):
    """Executor that runs chunks in spawned processes of one thread each and replaces workers that die.

    The work is pickled once; a problem from a scenario is pickled as the scenario. A thread for each worker
    gives it chunks, waits for its answers, and starts another process in the place of a lost one.
    """

    def __init__(self, workers: int) -> None:
        self.workers = workers
        self._window = Window(self, _IN_FLIGHT * workers)
        self._payload = b""
        self._added_variables: list[str] = []
        self._tickets: SimpleQueue[_Ticket | None] = SimpleQueue()
        self._threads: list[threading.Thread] = []
        self._processes: dict[threading.Thread, WorkerProcess] = {}
        self._starting = threading.Lock()
        self._closed = False

    def open(self, work: Work) -> None:
        """Start the workers; a process begins with its first chunk."""
        exit_if_unguarded()
        self._payload, self._closed = pickle_work(work), False
        # Processes read these before any of our code runs in them.
        self._added_variables = [name for name in _ONE_THREAD if name not in os.environ]
        os.environ.update(dict.fromkeys(self._added_variables, "1"))
        self._threads = [threading.Thread(target=self._serve, daemon=True) for _ in range(self.workers)]
        for thread in self._threads:
            thread.start()

    def map(self, chunks: Iterable[Task]) -> Iterator[Any]:
        """Yield outcomes in the order of the chunks."""
        return self._window.map(chunks)

    def submit(self, chunk: Task) -> _Ticket:
        """Queue a chunk for the next free worker."""
        ticket = _Ticket(self, chunk)
        self._tickets.put(ticket)
        return ticket

    def replace_lost(self) -> None:
        """Do nothing: the thread of a lost process starts the next one."""

    def look(self) -> None:
        """Give up processes that are stopped or dead, so that no thread waits for them."""
        for process in list(self._processes.values()):
            process.look()

    def close(self) -> None:
        """Stop the workers without waiting for running chunks."""
        self._closed = True
        if self._window.busy:
            with self._starting:  # a process that is being started is known afterwards
                for process in list(self._processes.values()):
                    process.kill()
        for _ in self._threads:
            self._tickets.put(None)
        for thread in self._threads:
            thread.join()
        self._threads = []
        for name in self._added_variables:
            os.environ.pop(name, None)
        self._added_variables = []

    def _serve(self) -> None:
        this = threading.current_thread()
        while (ticket := self._tickets.get()) is not None:
            try:
                ticket.answer.set_result(self._process_of(this).run(ticket.chunk))
            except BaseException as error:
                ticket.answer.set_exception(error)
                self._forget(this)
        self._forget(this)

    def _process_of(self, thread: threading.Thread) -> WorkerProcess:
        with self._starting:
            if self._closed:
                raise WorkerLost
            if thread not in self._processes:
                self._processes[thread] = WorkerProcess(self._payload)
            return self._processes[thread]

    def _forget(self, thread: threading.Thread) -> None:
        process = self._processes.pop(thread, None)
        if process is not None:
            process.close()


class _Ticket:
    def __init__(self, crew: ProcessExecutor, chunk: Task) -> None:
        self.crew, self.chunk = crew, chunk
        self.answer: Future[bytes] = Future()

    def done(self) -> bool:
        return self.answer.done()

    def result(self) -> Any:
        while True:
            try:
                return unpack(self.answer.result(timeout=_LOOK))
            except TimeoutError:
                if self.answer.done():  # a TimeoutError of the system itself
                    raise
                self.crew.look()


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
        text = "worker processes import this script, which is no file that they can read"
        raise UsageError(text, "save it as a file, or use workers=1")
    return payload
