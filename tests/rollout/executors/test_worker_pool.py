"""Chunks on workers that may die or hang, here as objects: who is to blame is found, and nobody else pays."""

import threading
import time
from concurrent.futures import CancelledError
from contextlib import closing

import numpy as np
import pytest

import avrare
from avrare.base.errors import AvrareError
from avrare.rollout.executors import worker_pool
from avrare.rollout.executors.work import FunctionCall, Work
from avrare.rollout.executors.worker_pool import WorkerDied, WorkerLost, WorkerPool
from avrare.rollout.noise import NoiseSource
from avrare.rollout.request import Request
from avrare.testing.faulty_systems import Walk
from rollout_requests import cut, fresh

ROWS, CHUNK = 120, 40


class Hand:
    def __init__(self, pool):
        self.pool, self.killed = pool, threading.Event()

    def prepare(self):
        pass

    def look(self):
        pass

    def run(self, task):
        self.pool.tasks.append(task)
        rows = set() if isinstance(task, FunctionCall) or task.crash else set(task.particle.tolist())
        for row, (end, how) in self.pool.ends.items():
            if row in rows and self.pool.left[row] > 0:
                self.pool.left[row] -= 1
                if how.pop("waits", False) or "hangs" in how:
                    assert self.killed.wait(10.0)
                raise WorkerLost(end, **{name: value for name, value in how.items() if name != "hangs"})
        return self.pool.work.run(task)

    def kill(self):
        self.killed.set()

    def close(self):
        self.pool.closed += 1


class Pool(WorkerPool):
    """Workers that end on some rows: row -> how it ends; ``times`` each, by default every time."""

    def __init__(self, ends=(), times=10**6, timeout=None, workers=3):
        super().__init__(workers)
        self.ends = {row: (how.pop("end", "SIGSEGV"), how) for row, how in dict(ends).items()}
        self.left = dict.fromkeys(self.ends, times)
        self.tasks, self.started, self.closed = [], 0, 0
        formula, options = avrare.stl("always (x < 0.2)"), {"chunk": CHUNK, "rollout_timeout": timeout}
        problem = avrare.Problem(Walk(), formula, steps=5, **options)
        self.work = Work(problem, NoiseSource(0, 1), scored=True)

    def start_worker(self):
        self.started += 1
        return Hand(self)

    def outcomes(self):
        self.open(self.work)
        with closing(self):
            return list(self.map(iter(cut(ROWS, CHUNK))))


@pytest.fixture(scope="module")
def undisturbed():
    return Pool().outcomes()


def compare(outcomes, undisturbed, culprits):
    error = np.concatenate([outcome.error for outcome in outcomes])
    assert np.flatnonzero(error).tolist() == sorted(culprits)
    for name in ("robustness", "violated", "scores"):
        found, wanted = ([getattr(one, name) for one in many] for many in (outcomes, undisturbed))
        found, wanted = np.concatenate(found), np.concatenate(wanted)
        np.testing.assert_array_equal(found[~error], wanted[~error])
    assert not np.concatenate([outcome.violated for outcome in outcomes])[error].any()


@pytest.mark.parametrize("culprits", [[], [0], [119], [7, 8, 61], [39, 40]])
def test_rollouts_that_end_their_worker_are_errors_and_all_others_keep_their_bits(culprits, undisturbed):
    pool = Pool({row: {} for row in culprits})
    outcomes = pool.outcomes()
    compare(outcomes, undisturbed, culprits)
    messages = {text for outcome in outcomes for text in outcome.messages}
    assert messages == ({"the rollout ended its process (SIGSEGV)"} if culprits else set())
    assert pool.started == pool.closed
    assert (pool.restarts > 0) == bool(culprits)


def test_one_death_costs_few_workers():
    pool = Pool({17: {}})
    pool.outcomes()
    assert pool.restarts == 2 + 3  # the chunk twice, then 10, 2 and 1 rollouts


@pytest.mark.parametrize("how", [{}, {"blameless": True}])
def test_a_death_that_does_not_repeat_is_no_error(how, undisturbed):
    pool = Pool({3: how, 50: how}, times=1)
    compare(pool.outcomes(), undisturbed, [])
    assert pool.restarts == 2


def test_want_of_memory_is_never_an_error_of_a_rollout(undisturbed):
    with pytest.raises(WorkerDied, match=r"without an answer \(out of memory\) on the chunk of 40 rollouts"):
        Pool({3: {"blameless": True, "end": "out of memory"}}).outcomes()
    pool = Pool({3: {"blameless": True}}, times=4)  # smaller parts fit into it
    compare(pool.outcomes(), undisturbed, [])


def test_rollouts_that_hang_are_errors(monkeypatch, undisturbed):
    monkeypatch.setattr(worker_pool, "_LOOK_SECONDS", 0.01)
    pool = Pool({5: {"hangs": True}, 90: {"hangs": True}}, timeout=0.05)
    outcomes = pool.outcomes()
    compare(outcomes, undisturbed, [5, 90])
    messages = {text for outcome in outcomes for text in outcome.messages}
    assert messages == {"the rollout takes more than 0.05 s"}


def test_a_chunk_may_take_longer_than_a_rollout(monkeypatch, undisturbed):
    """Divide the first one, whose time is not known, and blame nobody."""
    monkeypatch.setattr(worker_pool, "_LOOK_SECONDS", 0.01)

    class Slow(Hand):
        def run(self, task):
            if isinstance(task, Request) and self.killed.wait(0.02 * task.rows):
                raise WorkerLost("SIGKILL", blameless=True)
            return super().run(task)

    pool = Pool(timeout=0.3, workers=1)
    pool.start_worker = lambda: Slow(pool)
    compare(pool.outcomes(), undisturbed, [])


def test_an_estimate_whose_rollouts_all_crash_is_given_up_soon():
    pool = Pool({row: {} for row in range(ROWS)})
    with pytest.raises(WorkerDied, match=r"SIGSEGV, as each of 8 rollouts alone"):
        pool.outcomes()
    assert pool.restarts < 60


def test_an_errand_that_always_ends_its_worker_is_named():
    pool = Pool()
    pool.open(pool.work)
    Hand.run, run = lambda hand, task: (_ for _ in ()).throw(WorkerLost("SIGSEGV")), Hand.run
    try:
        with closing(pool), pytest.raises(WorkerDied, match=r"\(SIGSEGV\) in a look around"):
            list(pool.map([FunctionCall("a look around", len, ())]))
    finally:
        Hand.run = run
    assert pool.restarts == 3


def test_no_more_chunks_are_taken_than_there_is_room_for():
    pool, taken = Pool(), []

    def source():
        for chunk in cut(30, 1):
            taken.append(chunk)
            yield chunk

    pool.open(pool.work)
    with closing(pool):
        outcomes = pool.map(source())
        for done in range(20):
            next(outcomes)
            assert len(taken) == done + 6


def test_an_error_of_a_chunk_comes_in_order():
    pool, chunks = Pool(), cut(9, 1)
    chunks[4] = Request.replay(np.zeros((1, 2, 7)))
    pool.open(pool.work)
    with closing(pool):
        outcomes = pool.map(chunks)
        assert [int(next(outcomes).error.sum()) for _ in range(4)] == [0, 0, 0, 0]
        with pytest.raises((ValueError, IndexError, AvrareError)):
            next(outcomes)


def test_closing_waits_for_no_running_chunk():
    pool = Pool({0: {"hangs": True}}, workers=1)
    pool.open(pool.work)
    outcomes = pool.map([fresh(ROWS)])

    def wait_for_it():
        with pytest.raises(CancelledError):
            next(outcomes)

    thread = threading.Thread(target=wait_for_it)
    thread.start()
    while not pool.tasks:
        time.sleep(0.01)
    pool.close()
    thread.join()
    assert pool.closed == pool.started
