"""Ctrl-C reaches whoever runs a solver, and never its result."""

import multiprocessing
import os
import signal
import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from avrare_mpc.casadi_search import NlpSolver
from avrare_mpc.config import MpcConfig
from avrare_mpc.nlp import build_problem, pack_parameters
from avrare_mpc.plan import shift, start_of, to_variables
from avrare_mpc.signal_guard import defer_signals


@pytest.fixture(autouse=True)
def _heeding():
    """Heed Ctrl-C as from a terminal: a shell may let what it runs in the background ignore it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def interrupt_solves(solver, guess, parameters):
    """Solve until Ctrl-C, fifteen times, each time a little later; no solve comes out otherwise."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
    expected = solver.solve(guess, parameters)
    for number in range(15):
        found = []
        with pytest.raises(KeyboardInterrupt):  # noqa: PT012
            threading.Timer(0.004 + 0.0007 * number, os.kill, (os.getpid(), signal.SIGINT)).start()
            while True:
                found.append(solver.solve(guess, parameters))
        for one in found:
            assert one.retried == expected.retried
            assert np.array_equal(one.variables, expected.variables)


@pytest.mark.parametrize("first", ["fatrop", "ipopt"])
def test_an_interrupted_solve_is_finished_before_the_interruption(lane_change, quiet, first):
    solver, scene = NlpSolver(build_problem(MpcConfig(), lane_change.scene), first), lane_change.scene
    memory, ego, prediction = quiet[1].inputs[5]
    start = start_of(ego)
    (parameters,) = pack_parameters(scene, start, prediction.x, prediction.y)
    (guess,) = to_variables(*shift(memory.plan_states, memory.plan_inputs, scene.dt))
    # In a process of its own: on a busy machine a signal may come late, and must not hit another test.
    child = multiprocessing.get_context("fork").Process(
        target=interrupt_solves, args=(solver, guess, parameters)
    )
    child.start()
    child.join()
    assert child.exitcode == 0


def test_signals_are_delivered_at_the_end_in_order():
    seen, ctrl_c = [], signal.getsignal(signal.SIGINT)

    def asked_twice():
        with defer_signals():
            signal.raise_signal(signal.SIGTERM)
            signal.raise_signal(signal.SIGINT)
            seen.append("done")

    signal.signal(signal.SIGTERM, lambda number, _: seen.append("term"))
    try:
        with pytest.raises(KeyboardInterrupt):
            asked_twice()
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
    assert seen == ["done", "term"]
    assert signal.getsignal(signal.SIGINT) is ctrl_c


def test_unhandled_signals_are_left_alone():
    with defer_signals():
        assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL


def test_other_threads_may_solve():
    def solve():
        with defer_signals():
            return "solved"

    with ThreadPoolExecutor() as threads:
        assert threads.submit(solve).result() == "solved"
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
