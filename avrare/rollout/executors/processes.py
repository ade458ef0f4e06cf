"""Executor with worker processes on this machine."""

from __future__ import annotations

import os
import pickle
import sys

from avrare.base.errors import UsageError
from avrare.rollout.executors.work import ExecutorConfig, Work
from avrare.rollout.executors.worker_pool import WorkerPool
from avrare.rollout.executors.worker_process import HINT, WorkerProcess, exit_if_unguarded


def build(config: ExecutorConfig, scene: object | None = None) -> ProcessExecutor:
    """Build the executor."""
    return ProcessExecutor(config.workers)


class ProcessExecutor(WorkerPool):
    """Executor that runs chunks in spawned processes of one thread each.

    The work is pickled once; a problem from a scenario is pickled as the scenario.
    """

    def open(self, work: Work) -> None:
        """Take the work; a process starts with its first task."""
        exit_if_unguarded()
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
