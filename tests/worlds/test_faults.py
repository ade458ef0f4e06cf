"""Worlds that raise, exit, hang or have no number: each is one counted error, and the others go on."""

import signal
import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from scipy.stats import norm

import avrare
from avrare.base.errors import UsageError
from avrare.rollout.noise import NoiseSource
from avrare.worlds import StepTimeout, as_system
from avrare.worlds.step_timeout import Watchdog

ROLLOUTS, STEPS = 60, 4
NOISE = NoiseSource(5, 1).normals(0, 0, np.arange(ROLLOUTS)[:, None], np.arange(STEPS + 1))
BROKEN = int((NOISE[:, 1:, 0] > 2.0).any(axis=1).sum())
"""Rollouts that meet a number beyond which the toys break down."""


def estimate(world, workers=1, step_timeout=None, estimator="mc", **options):
    system = as_system(world, step_timeout=step_timeout)
    problem = avrare.Problem(system, avrare.stl("always (x < 0.5)"), STEPS, chunk=15)
    options = options or {"rollouts": ROLLOUTS}
    return avrare.estimate(problem, estimator, seed=5, workers=workers, **options)


def test_rows_break_down_independently():
    assert 2 <= BROKEN <= 12
    assert abs(BROKEN / ROLLOUTS - (1.0 - norm.cdf(2.0) ** STEPS)) < 0.1


@pytest.mark.slow
@pytest.mark.parametrize("workers", [1, 2])
@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("Raising", "ValueError: too large"), ("Exiting", "RuntimeError: the world exits: 3"),
        ("Missing", "NaN in signal"), ("Hanging", "StepTimeout: the step did not end within 0.2 s"),
    ],
)  # fmt: skip
def test_rollouts_that_break_down_are_counted(toys, name, message, workers):
    result = estimate(getattr(toys, name), workers, step_timeout=0.2 if name == "Hanging" else None)
    assert result.errors == BROKEN
    assert result.rollouts == ROLLOUTS
    assert message in result.health["errors"]
    sound = estimate(toys.Walk)
    assert result.probability <= sound.probability
    assert result.interval[1] >= sound.interval[1]


def test_a_step_that_raised_is_not_retried(toys):
    toys.Raising.tried = 0
    assert estimate(toys.Raising).errors == BROKEN
    assert toys.Raising.tried == BROKEN


@pytest.mark.parametrize("name", ["Raising", "Missing"])
def test_splitting_continues_after_errors(toys, name):
    result = estimate(getattr(toys, name), estimator="ams", particles=30, discard=6, runs=2)
    assert result.errors > 0
    assert result.rollouts > 60


def test_a_world_that_raises_at_the_start(toys):
    class Stillborn(toys.Walk):
        def reset(self, noise):
            if noise[0] > 1.0:
                raise OSError("no display")
            super().reset(noise)

    result = estimate(Stillborn)
    assert result.errors == int((NOISE[:, 0, 0] > 1.0).sum()) > 0
    assert "OSError: no display" in result.health["errors"]


def test_the_signal_handler_and_timer_are_restored():
    heard = []
    before = signal.signal(signal.SIGALRM, lambda *_: heard.append(1))
    try:
        with Watchdog(5.0) as watch:
            assert watch.call(max, 1, 2) == 2
        assert signal.getitimer(signal.ITIMER_REAL) == (0.0, 0.0)
        signal.raise_signal(signal.SIGALRM)
        assert heard == [1]
    finally:
        signal.signal(signal.SIGALRM, before)


def test_a_step_that_swallows_exceptions_is_still_interrupted():
    def stubborn():
        while True:
            try:
                threading.Event().wait(60)
            except Exception:
                continue

    with Watchdog(0.05) as watch, pytest.raises(StepTimeout, match=r"the step did not end within 0\.05 s"):
        watch.call(stubborn)


def test_a_limit_needs_the_main_thread(toys):
    with ThreadPoolExecutor() as threads, pytest.raises(UsageError, match="main thread"):
        threads.submit(estimate, toys.Walk, step_timeout=1.0).result()
