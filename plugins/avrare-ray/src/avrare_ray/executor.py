"""Ray executor: one actor per worker, which holds the problem.

Requests and outcomes are sent as bytes, since Ray returns read-only arrays.
"""

from __future__ import annotations

import contextlib
import importlib
import pickle
import signal
import threading
from collections.abc import Iterator
from typing import Any

from avrare.base.errors import AvrareError
from avrare.rollout.executors.processes import pack, pickle_work, unpack
from avrare.rollout.executors.work import Task, Work
from avrare.rollout.executors.worker_pool import WorkerLost, WorkerPool
from avrare_ray.config import RayConfig


def build(config: RayConfig, scene: object | None = None) -> RayExecutor:
    """Build the executor of a scenario or a call."""
    return RayExecutor(config)


class Actor:
    """Actor that runs tasks.

    Args:
        payload: Pickled work.
    """

    def __init__(self, payload: bytes) -> None:
        self.work: Work = pickle.loads(payload)

    def run(self, task: bytes) -> bytes:
        """Return the pickled outcome of a task, or the pickled exception; of none nothing."""
        return pack(self.work, pickle.loads(task)) if task else b""


class RayExecutor(WorkerPool):
    """Executor on Ray actors; outcomes are bit-identical to those of other executors."""

    def __init__(self, config: RayConfig) -> None:
        super().__init__(config.workers)
        self.config = config
        self._ray: Any = None
        self._owns_cluster = False

    def open(self, work: Work) -> None:
        """Connect to the cluster, or start one on this machine.

        Raises:
            UsageError: The problem cannot be sent to another process.
            AvrareError: The cluster cannot be reached.
        """
        payload = pickle_work(work)
        self._ray = importlib.import_module("ray")
        if not self._ray.is_initialized():
            self._join()
        self._payload = self._ray.put(payload)
        super().open(work)

    def start_worker(self) -> RayWorker:
        """Start an actor."""
        one_thread = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
        environment = {**one_thread, **self.config.runtime_env.get("env_vars", {})}
        remote = self._ray.remote(
            num_cpus=self.config.cpus_per_worker,
            max_restarts=0,
            runtime_env={**self.config.runtime_env, "env_vars": environment},
        )
        return RayWorker(self._ray, remote(Actor).remote(self._payload))

    def close(self) -> None:
        """Stop the actors, and the cluster if this executor started it."""
        if self._ray is None:
            return
        super().close()
        if self._owns_cluster:
            self._ray.shutdown()
        self._ray, self._payload, self._owns_cluster = None, None, False

    def _join(self) -> None:
        options: dict[str, Any] = {"address": self.config.address} if self.config.address else {}
        if self.config.runtime_env:
            options["runtime_env"] = self.config.runtime_env
        try:
            with _keep_sigterm_handler():
                self._ray.init(log_to_driver=False, logging_level="warning", **options)
        except Exception as error:  # many types: unknown host, version mismatch, no permission
            cluster = self.config.address or "of this machine"
            text = " ".join(str(error).split())
            raise AvrareError(
                f"cannot reach the Ray cluster {cluster}: {text}", "see `ray status`"
            ) from error
        self._owns_cluster = True


@contextlib.contextmanager
def _keep_sigterm_handler() -> Iterator[None]:
    before = signal.getsignal(signal.SIGTERM)
    try:
        yield
    finally:
        if threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGTERM, before)


class RayWorker:
    """Actor of the cluster, seen from here."""

    def __init__(self, ray: Any, actor: Any) -> None:
        self._ray, self._actor = ray, actor

    def prepare(self) -> None:
        """Wait until the actor has the work."""
        self._ask(b"")

    def run(self, task: Task) -> Any:
        """Return the outcome of a task, or raise its exception; raise ``WorkerLost`` if the actor dies."""
        return unpack(self._ask(pickle.dumps(task)))

    def look(self) -> None:
        """Do nothing: the cluster notices an actor that dies."""

    def kill(self) -> None:
        """Kill the actor."""
        with contextlib.suppress(Exception):  # it may be dead already
            self._ray.kill(self._actor)

    close = kill

    def _ask(self, question: bytes) -> bytes:
        lost = self._ray.exceptions
        try:
            answer: bytes = self._ray.get(self._actor.run.remote(question))
        except lost.OutOfMemoryError as error:
            raise WorkerLost("out of memory", blameless=True) from error
        except (
            lost.RayActorError,
            lost.ObjectLostError,
            lost.WorkerCrashedError,
            lost.NodeDiedError,
        ) as error:
            raise WorkerLost("its actor died") from error
        return answer
