"""A pool of worker processes on this machine."""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool

from avrare.errors import AvrareError, ExitCode, UsageError
from avrare.execute.config import ExecutorConfig
from avrare.execute.work import Work
from avrare.rollout.request import Request, Rollouts

_HINT = "define the system, its parts and the score at the top level of a module, or use workers=1"
_ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
_work: Work | UsageError | None = None


class WorkerDied(AvrareError):
    """A worker process ended without an answer."""

    exit_code = ExitCode.ROLLOUT_ERRORS


def build(config: ExecutorConfig, scene: object | None = None) -> ProcessExecutor:
    """The executor of a scenario or a call."""
    return ProcessExecutor(config.workers)


class ProcessExecutor:
    """Runs chunks in spawned processes of one thread each.

    The work is pickled once per worker; a problem built from a scenario travels as its recipe.
    """

    def __init__(self, workers: int) -> None:
        self.workers = workers
        self._pool: ProcessPoolExecutor | None = None
        self._added: list[str] = []

    def open(self, work: Work) -> None:
        """Start the workers.

        Raises:
            UsageError: The problem cannot be sent to another process.
        """
        payload = _pickled(work)
        # Workers start with the first chunk and read these before anything of ours runs in them.
        self._added = [name for name in _ONE_THREAD if name not in os.environ]
        os.environ.update(dict.fromkeys(self._added, "1"))
        context = multiprocessing.get_context("spawn")
        self._pool = ProcessPoolExecutor(self.workers, context, initializer=_start, initargs=(payload,))

    def map(self, chunks: Sequence[Request]) -> Iterator[Rollouts]:
        """Outcomes in the order of the chunks."""
        assert self._pool is not None
        try:
            yield from self._pool.map(_run, chunks)
        except BrokenProcessPool as error:
            raise WorkerDied(
                "a worker process ended without an answer (killed, out of memory, or failed to start)",
                "run with --workers 1 to see what happens; in a script, guard the call with "
                '`if __name__ == "__main__":`',
            ) from error

    def close(self) -> None:
        """Stop the workers."""
        if self._pool is not None:
            self._pool.shutdown(wait=True, cancel_futures=True)
            self._pool = None
        for name in self._added:
            os.environ.pop(name, None)
        self._added = []


def _pickled(work: Work) -> bytes:
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
    try:
        _work = pickle.loads(payload)
    except Exception as error:  # an initializer that raises would break the pool without a reason
        _work = UsageError(f"a worker process cannot read the problem: {error}", _HINT)


def _run(chunk: Request) -> Rollouts:
    if isinstance(_work, UsageError):
        raise _work
    assert _work is not None
    return _work.run(chunk)
