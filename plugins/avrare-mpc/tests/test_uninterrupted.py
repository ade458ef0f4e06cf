"""Ctrl-C reaches whoever runs a solver, and never its result."""

import os
import signal
import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from avrare_mpc.config import MpcConfig
from avrare_mpc.plan import shift, to_variables
from avrare_mpc.problem import build_problem, pack_parameters
from avrare_mpc.solver import NlpSolver
from avrare_mpc.uninterrupted import uninterrupted


@pytest.fixture(autouse=True)
def _heeding():
    """As from a terminal: a shell may let what it runs in the background ignore Ctrl-C."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.parametrize("first", ["fatrop", "ipopt"])
def test_an_interrupted_solve_is_finished_before_the_interruption(lane_change, quiet, first):
    solver, scene = NlpSolver(build_problem(MpcConfig(), lane_change.scene), first), lane_change.scene
    memory, ego, prediction = quiet[1].inputs[5]
    start = np.stack([ego.x, ego.y, ego.speed, ego.heading], axis=1)
    (parameters,) = pack_parameters(scene, start, prediction.x, prediction.y)
    (guess,) = to_variables(*shift(memory.plan_states, memory.plan_inputs, scene.dt))
    expected = solver.solve(guess, parameters)
    for number in range(15):
        threading.Timer(0.004 + 0.0007 * number, os.kill, (os.getpid(), signal.SIGINT)).start()
        found = []
        with pytest.raises(KeyboardInterrupt):
            found.extend(solver.solve(guess, parameters) for _ in range(2000))
        for one in found:
            assert one.retried == expected.retried
            assert np.array_equal(one.variables, expected.variables)


def test_signals_are_given_out_at_the_end_in_their_order():
    seen, ctrl_c = [], signal.getsignal(signal.SIGINT)

    def asked_twice():
        with uninterrupted():
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


def test_what_nobody_handles_is_left_alone():
    with uninterrupted():
        assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL


def test_other_threads_may_solve():
    def solve():
        with uninterrupted():
            return "solved"

    with ThreadPoolExecutor() as threads:
        assert threads.submit(solve).result() == "solved"
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
