"""Executor that runs everything in this process."""

from __future__ import annotations

import faulthandler
from collections.abc import Iterable, Iterator
from contextlib import suppress
from functools import partial
from typing import Any

from avrare.rollout.child_process import run_guarded
from avrare.rollout.executors.work import Executor, ExecutorConfig, FunctionCall, Task, Work


def build(config: ExecutorConfig, scene: object | None = None) -> SerialExecutor:
    """Build the executor."""
    return SerialExecutor()


class SerialExecutor(Executor):
    """Executor that runs one chunk after another.

    A function call runs in a child process until a chunk has run here. A chunk that crashes ends this process
    and says where. Rollouts with a time limit run in a separate process.
    """

    _says_where = False
    _other: Executor | None = None

    def open(self, work: Work) -> None:
        """Remember the work."""
        self._work = work
        if work.problem.rollout_timeout is not None:
            from avrare.rollout.executors.processes import ProcessExecutor  # late: it needs multiprocessing

            self._other = ProcessExecutor(1)
            self._other.open(work)
            return
        if not faulthandler.is_enabled():
            with suppress(AttributeError, OSError, ValueError):  # no standard error, or one that is no file
                faulthandler.enable(all_threads=False)
                self._says_where = True

    def map(self, chunks: Iterable[Task]) -> Iterator[Any]:
        """Yield outcomes in the order of the chunks."""
        return map(self._run, chunks) if self._other is None else self._other.map(chunks)

    def close(self) -> None:
        """Leave crashes alone again, and stop a process."""
        if self._other is not None:
            self._other.close()
            self.restarts, self._other = self.restarts + self._other.restarts, None
        if self._says_where:
            faulthandler.disable()
            self._says_where = False

    def _run(self, task: Task) -> object:
        if isinstance(task, FunctionCall):
            return run_guarded(task.purpose, self._work.problem.system, partial(self._work.run, task))
        return self._work.run(task)
