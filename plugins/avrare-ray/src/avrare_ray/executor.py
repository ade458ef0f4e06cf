"""Ray executor: one actor per worker, which holds the problem; a dead actor is replaced.

Requests and outcomes are sent as bytes, since Ray returns read-only arrays.
"""

from __future__ import annotations

import contextlib
import importlib
import pickle
import signal
import threading
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

from avrare.base.errors import AvrareError
from avrare.rollout.executors.in_flight import Window, WorkerLost
from avrare.rollout.executors.processes import pickle_work
from avrare.rollout.executors.work import Executor, Task, Work
from avrare.rollout.executors.worker_process import pack, unpack
from avrare_ray.config import RayConfig

_IN_FLIGHT = 2
"""Chunks in flight per worker: one running, one waiting."""
_ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")


def build(config: RayConfig, scene: object | None = None) -> RayExecutor:
    """Build the executor of a scenario or a call."""
    return RayExecutor(config)


class Worker:
    """Actor that runs chunks.

    Args:
        payload: Pickled work.
    """

    def __init__(self, payload: bytes) -> None:
        self.work: Work = pickle.loads(payload)

    def run(self, chunk: bytes) -> bytes:
        """Return the pickled outcome of a chunk, or the pickled exception."""
        return pack(self.work, pickle.loads(chunk))


class RayExecutor(Executor):
    """Executor on Ray actors; outcomes are bit-identical to those of other executors."""

    def __init__(self, config: RayConfig) -> None:
        self.config, self.workers = config, config.workers
        self._window = Window(self, _IN_FLIGHT * config.workers)
        self._actors: list[_Actor] = []
        self._ray: Any = None
        self._owns_cluster = False
        self._payload: Any = None

    def open(self, work: Work) -> None:
        """Connect to the cluster, or start one on this machine, and start the actors.

        Raises:
            UsageError: The problem cannot be sent to another process.
            AvrareError: The cluster cannot be reached.
        """
        payload = pickle_work(work)
        self._ray = importlib.import_module("ray")
        if not self._ray.is_initialized():
            self._join()
        self._payload = self._ray.put(payload)
        self._actors = [self._start_actor() for _ in range(self.config.workers)]

    def map(self, chunks: Iterable[Task]) -> Iterator[Any]:
        """Run the chunks and yield their outcomes in the same order.

        Raises:
            WorkerDied: Several workers died while running the same chunk.
        """
        return self._window.map(chunks)

    def submit(self, chunk: Task) -> _Ticket:
        """Submit a chunk to the worker with the fewest chunks."""
        actor = min(self._actors, key=lambda worker: worker.load)
        ticket = _Ticket(self._ray, actor, actor.handle.run.remote(pickle.dumps(chunk)))
        actor.tickets.append(ticket)
        return ticket

    def replace_lost(self) -> None:
        """Replace the actors that have died."""
        self._actors = [self._start_actor() if actor.dead else actor for actor in self._actors]

    def close(self) -> None:
        """Stop the actors, and the cluster if this executor started it."""
        if self._ray is None:
            return
        for actor in self._actors:
            with contextlib.suppress(Exception):  # it may be dead already
                self._ray.kill(actor.handle)
        if self._owns_cluster:
            self._ray.shutdown()
        self._actors, self._ray, self._payload, self._owns_cluster = [], None, None, False

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

    def _start_actor(self) -> _Actor:
        environment = {**_ONE_THREAD, **self.config.runtime_env.get("env_vars", {})}
        remote = self._ray.remote(
            num_cpus=self.config.cpus_per_worker,
            max_restarts=0,
            runtime_env={**self.config.runtime_env, "env_vars": environment},
        )
        return _Actor(remote(Worker).remote(self._payload), [])


@contextlib.contextmanager
def _keep_sigterm_handler() -> Iterator[None]:
    before = signal.getsignal(signal.SIGTERM)
    try:
        yield
    finally:
        if threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGTERM, before)


@dataclass
class _Actor:
    handle: Any
    tickets: list[_Ticket]
    dead: bool = False

    @property
    def load(self) -> int:
        """Number of unfinished chunks."""
        self.tickets = [ticket for ticket in self.tickets if not ticket.done()]
        return len(self.tickets)


@dataclass(frozen=True)
class _Ticket:
    ray: Any
    actor: _Actor
    reference: Any

    def done(self) -> bool:
        return self.actor.dead or bool(self.ray.wait([self.reference], timeout=0)[0])

    def result(self) -> Any:
        lost = self.ray.exceptions
        try:
            answer = self.ray.get(self.reference)
        except (
            lost.RayActorError,
            lost.ObjectLostError,
            lost.WorkerCrashedError,
            lost.NodeDiedError,
        ):
            self.actor.dead = True
            raise WorkerLost from None
        return unpack(answer)
