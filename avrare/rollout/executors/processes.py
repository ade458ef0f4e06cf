"""Executor with a pool of worker processes on this machine."""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
import sys
import threading
from collections.abc import Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass

from avrare.base.errors import UsageError
from avrare.rollout.executors.in_flight import Window, WorkerDied, WorkerLost
from avrare.rollout.executors.serial import ExecutorConfig
from avrare.rollout.executors.work import Work
from avrare.rollout.request import Request, Rollouts

__all__ = ["ProcessExecutor", "WorkerDied", "build"]

_HINT = "define the system, its parts and the score at the top level of a module, or use workers=1"
_ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
_IN_FLIGHT = 2
"""Chunks in flight for each worker: one running, one queued."""
_work: Work | UsageError | None = None


def build(config: ExecutorConfig, scene: object | None = None) -> ProcessExecutor:
    """Build the executor."""
    return ProcessExecutor(config.workers)


class ProcessExecutor:
    """Executor that runs chunks in spawned processes of one thread each and replaces workers that die.

    The work is pickled once per worker; a problem from a scenario is pickled as the scenario.
    """

    def __init__(self, workers: int) -> None:
        self.workers = workers
        self._pool: ProcessPoolExecutor | None = None
        self._window = Window(self, _IN_FLIGHT * workers)
        self._payload = b""
        self._added_variables: list[str] = []

    @property
    def restarts(self) -> int:
        """Number of times that workers were replaced."""
        return self._window.restarts

    def open(self, work: Work) -> None:
        """Start the workers."""
        self._payload = pickle_work(work)
        # Workers start with the first chunk and read these before any of our code runs in them.
        self._added_variables = [name for name in _ONE_THREAD if name not in os.environ]
        os.environ.update(dict.fromkeys(self._added_variables, "1"))
        self._pool = self._fresh_pool()

    def map(self, chunks: Iterable[Request]) -> Iterator[Rollouts]:
        """Yield outcomes in the order of the chunks."""
        return self._window.map(chunks)

    def submit(self, chunk: Request) -> _Ticket:
        """Submit a chunk to the pool."""
        assert self._pool is not None
        try:
            with _no_interrupt():  # the first chunk starts the workers
                return _Ticket(self._pool.submit(_run, chunk))
        except BrokenProcessPool as error:
            raise WorkerLost from error

    def replace_lost(self) -> None:
        """Replace the pool: one that has lost a worker cannot be used any more."""
        assert self._pool is not None
        self._pool.shutdown(wait=True, cancel_futures=True)
        self._pool = self._fresh_pool()

    def close(self) -> None:
        """Stop the workers without waiting for running chunks."""
        if self._pool is not None:
            if self._window.busy:
                for process in list((self._pool._processes or {}).values()):
                    process.kill()
            self._pool.shutdown(wait=True, cancel_futures=True)
            self._pool = None
        for name in self._added_variables:
            os.environ.pop(name, None)
        self._added_variables = []

    def _fresh_pool(self) -> ProcessPoolExecutor:
        context = multiprocessing.get_context("spawn")
        return ProcessPoolExecutor(self.workers, context, initializer=_start, initargs=(self._payload,))


@contextmanager
def _no_interrupt() -> Iterator[None]:
    # Block SIGINT, so that processes started meanwhile ignore it from their first instruction on.
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@dataclass(frozen=True)
class _Ticket:
    future: Future[Rollouts]

    def done(self) -> bool:
        return self.future.done()

    def result(self) -> Rollouts:
        try:
            return self.future.result()
        except BrokenProcessPool as error:
            raise WorkerLost from error


def pickle_work(work: Work) -> bytes:
    """Pickle the work for a worker process."""
    try:
        payload = pickle.dumps(work)
    except Exception as error:
        raise UsageError(f"the problem cannot be sent to a worker process: {error}", _HINT) from error
    main = sys.modules["__main__"]
    importable = getattr(main, "__spec__", None) is not None or os.path.exists(getattr(main, "__file__", ""))
    if b"__main__" in payload and not importable:
        raise UsageError("the problem is defined in a session that a worker process cannot import", _HINT)
    return payload


def _start(payload: bytes) -> None:
    global _work
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent decides what Ctrl-C means
    threading.Thread(target=_exit_with_parent, daemon=True).start()
    try:
        _work = pickle.loads(payload)
    except Exception as error:  # an initializer that raises would break the pool without a reason
        _work = UsageError(f"a worker process cannot read the problem: {error}", _HINT)


def _exit_with_parent() -> None:
    # A parent that is killed cannot stop its workers, which would wait for work for ever.
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _run(chunk: Request) -> Rollouts:
    if isinstance(_work, UsageError):
        raise _work
    assert _work is not None
    return _work.run(chunk)
