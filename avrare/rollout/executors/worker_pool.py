"""Workers that may die or hang: a rollout that ends its worker is an error, all others keep their bits.

A thread for each worker gives it one task at a time. A chunk whose worker ends is run again in a new one,
then its parts are, down to the rollouts to blame. Rollouts have their own random streams, so the others give
the same bits as in one process.
"""

from __future__ import annotations

import math
import threading
import time
from abc import abstractmethod
from collections import deque
from collections.abc import Iterable, Iterator
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor
from dataclasses import replace
from itertools import islice, pairwise
from typing import Any, Protocol

from avrare.base.errors import AvrareError, ExitCode
from avrare.rollout.executors.work import Executor, FunctionCall, Task, Work
from avrare.rollout.request import Request, Rollouts

_LOOK_SECONDS = 0.5
"""Time between two looks at the workers while the parent waits for an outcome."""
_MOST_ATTEMPTS, _CHUNK_ATTEMPTS = 3, 2


class WorkerLost(Exception):
    """Worker that ended, or was ended, while it ran a task; the text says how.

    Attributes:
        blameless: True for want of memory or a kill, which are not errors of rollouts.
        hangs: True where it took too long.
    """

    def __init__(self, end: str, *, blameless: bool = False, hangs: bool = False) -> None:
        super().__init__(end)
        self.blameless, self.hangs = blameless, hangs


class WorkerDied(AvrareError):
    """Workers died on the same task, which no rollout can be blamed for."""

    exit_code = ExitCode.ROLLOUT_ERRORS


class Worker(Protocol):
    """Process that runs one task at a time."""

    def prepare(self) -> None:
        """Wait until it is ready for a task; raise ``WorkerLost`` if it dies."""

    def run(self, task: Task) -> Any:
        """Return the outcome, or raise the exception of the task; raise ``WorkerLost`` if it dies."""

    def look(self) -> None:
        """Kill it if it is stopped or dead, so that no thread waits for it."""

    def kill(self) -> None:
        """Kill it; a thread in ``run`` gets a ``WorkerLost``."""

    def close(self) -> None:
        """Wait until it, idle or killed, has ended."""


class WorkerPool(Executor):
    """Executor whose workers are replaced when they die or hang; a subclass starts them."""

    def __init__(self, workers: int) -> None:
        self.workers, self._lock = workers, threading.Lock()

    @abstractmethod
    def start_worker(self) -> Worker:
        """Start a worker for the work."""

    def open(self, work: Work) -> None:
        """Take the work; a worker starts with its first task."""
        self._closed, self._timeout = False, work.problem.rollout_timeout
        self._most_rows, self._most_seconds = 1, 0.0  # of a chunk so far
        self._idle: list[Worker] = []
        self._deadlines: dict[Worker, float] = {}
        self._threads = ThreadPoolExecutor(self.workers)

    def map(self, chunks: Iterable[Task]) -> Iterator[Any]:
        """Yield outcomes in the order of the chunks, taking a chunk when there is room for it."""
        source, flights = iter(chunks), deque[Future[Any]]()
        while True:
            room = 2 * self.workers - len(flights)  # for each worker one that runs, one that waits
            flights.extend(self._threads.submit(self._run, chunk) for chunk in islice(source, room))
            if not flights:
                return
            yield self._wait(flights.popleft())

    def close(self) -> None:
        """Stop the workers without waiting for running chunks."""
        with self._lock:  # no worker starts from now on
            self._closed = True
            busy = list(self._deadlines)
        for worker in busy:
            worker.kill()
        self._threads.shutdown(cancel_futures=True)
        for worker in self._idle:
            worker.close()

    def _wait(self, flight: Future[Any]) -> Any:
        while not flight.done():
            try:
                return flight.result(timeout=_LOOK_SECONDS)
            except TimeoutError:  # of this wait, or of the system itself
                for worker, deadline in list(self._deadlines.items()):
                    worker.kill() if time.monotonic() > deadline else worker.look()
        return flight.result()

    def _run(self, task: Task) -> Any:
        try:
            if isinstance(task, FunctionCall):
                return self._try(task, _MOST_ATTEMPTS)
            return self._run_chunk(task, _CHUNK_ATTEMPTS, [])
        except WorkerLost as loss:
            raise WorkerDied(
                f"worker processes ended without an answer ({loss}) {task.describe()}",
                "run with a single worker to see the cause",
            ) from None

    def _run_chunk(self, chunk: Request, attempts: int, crashes: list[bool]) -> Rollouts:
        """Run a chunk, in parts where it ends its workers; ``crashes`` has an entry for each part so far."""
        try:
            outcome: Rollouts = self._try(chunk, attempts)
        except WorkerLost as loss:
            if chunk.rows > 1:
                count = 4  # fewer workers die than with halves, and as many parts are run
                edges = [chunk.rows * part // count for part in range(count + 1)]
                parts = [chunk.slice(*pair) for pair in pairwise(edges) if pair[0] < pair[1]]
                # The chunk was tried again before, so that one more death is enough.
                return Rollouts.join([self._run_chunk(part, 1, crashes) for part in parts])
            crashes.append(True)
            if loss.blameless or chunk.crash:
                raise
            most_crashes = 8
            if len(crashes) == most_crashes and all(crashes):
                raise WorkerLost(f"{loss}, as each of {most_crashes} rollouts alone") from None
            how = f"takes more than {self._timeout:g} s" if loss.hangs else f"ended its process ({loss})"
            return self._run_chunk(replace(chunk, crash=f"the rollout {how}"), _CHUNK_ATTEMPTS, [])
        crashes.append(False)
        return outcome

    def _try(self, task: Task, attempts: int) -> Any:
        """Run a task in up to ``attempts`` workers: in more where it is not to blame, in one if it hangs."""
        attempt = 0
        while True:
            attempt += 1
            try:
                return self._attempt(task)
            except WorkerLost as loss:
                if loss.hangs or attempt >= (_MOST_ATTEMPTS if loss.blameless else attempts):
                    raise

    def _attempt(self, task: Task) -> Any:
        with self._lock:
            if self._closed:
                raise CancelledError
            worker = self._idle.pop() if self._idle else self.start_worker()
            self._deadlines[worker] = math.inf
        free = False
        try:
            worker.prepare()
            began, limit = time.monotonic(), self._time_limit(task)
            self._deadlines[worker] = began + limit
            outcome = worker.run(task)
            seconds, free = time.monotonic() - began, True
        except WorkerLost:
            with self._lock:
                self.restarts += 1
            if time.monotonic() > self._deadlines[worker]:
                raise WorkerLost(f"no answer within {limit:.3g} s", hangs=True) from None
            raise
        finally:
            with self._lock:
                del self._deadlines[worker]
                if free:
                    self._idle.append(worker)
            if not free:
                worker.close()
        if isinstance(task, Request):
            self._most_rows, self._most_seconds = (
                max(self._most_rows, task.rows),
                max(self._most_seconds, seconds),
            )
        return outcome

    def _time_limit(self, task: Task) -> float:
        """Return the seconds after which a task is divided, or given up."""
        if self._timeout is None:
            return math.inf
        if isinstance(task, FunctionCall):
            return 100 * self._timeout  # a function call may take as long as 100 rollouts
        # time that a chunk may take beside the limit of a rollout, over that of the slowest chunk so far
        factor = 3.0
        return self._timeout + factor * self._most_seconds * max(task.rows / self._most_rows, 1.0)
