"""The executor on a real Ray cluster of this machine."""

import fcntl
import os
import signal
import tempfile
from pathlib import Path

import numpy as np
import pytest
import ray

import avrare
from avrare.estimation.loop.loop import run
from avrare.estimation.monte_carlo.config import McConfig
from avrare.estimation.monte_carlo.monte_carlo import MonteCarlo
from avrare.estimation.plan.plan import Settings
from avrare.rollout.executors.serial import SerialExecutor
from avrare.rollout.executors.worker_pool import WorkerDied
from avrare.testing import faulty_systems as systems
from avrare_estimators.ams.config import AmsConfig
from avrare_estimators.ams.splitting import Splitting
from avrare_ray.config import RayConfig
from avrare_ray.executor import build

pytestmark = pytest.mark.slow

HERE = str(Path(__file__).parent)
IN_THE_PROBE, IN_A_CHUNK = 1, 15
"""Samples: the probe runs the first ten."""


@pytest.fixture(scope="module", autouse=True)
def alone():
    """Keep the tests of this file in one process at a time: one of them looks for clusters of others."""
    with (Path(tempfile.gettempdir()) / "avrare-ray-tests.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield
        ray.shutdown()


@pytest.fixture
def cluster():
    if not ray.is_initialized():
        path = os.pathsep.join([HERE, os.environ.get("PYTHONPATH", "")])
        environment = {"env_vars": {"PYTHONPATH": path}}
        ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False, runtime_env=environment)


@pytest.fixture
def no_cluster():
    ray.shutdown()


def problem(system=None, **options):
    formula = avrare.stl("always (x < 0.5)")
    return avrare.Problem(system or systems.Walk(), formula, steps=20, chunk=10, **options)


def estimate(executor, task=None, **options):
    estimator = MonteCarlo(McConfig(**{"rollouts": 200, **options}))
    return run(task or problem(), estimator, executor, Settings())[0]


@pytest.mark.usefixtures("cluster")
def test_the_same_bits_as_in_one_process():
    one, two = estimate(SerialExecutor()), estimate(build(RayConfig(workers=2)))
    assert (one.probability, one.simulated_steps) == (two.probability, two.simulated_steps)
    assert one.health == two.health
    np.testing.assert_array_equal(one.robustness, two.robustness)
    np.testing.assert_array_equal(one.failures.noise, two.failures.noise)


@pytest.mark.usefixtures("cluster")
def test_splitting_copies_states_through_ray():
    splitting = Splitting(AmsConfig(particles=30, discard=6, runs=2))
    executors = SerialExecutor(), build(RayConfig(workers=2))
    results = [run(problem(), splitting, one, Settings())[0] for one in executors]
    assert results[0].probability == results[1].probability
    np.testing.assert_array_equal(results[0].failures.noise, results[1].failures.noise)


@pytest.mark.usefixtures("cluster")
@pytest.mark.parametrize("sample", [IN_THE_PROBE, IN_A_CHUNK])
def test_a_dead_actor_is_replaced(tmp_path, monkeypatch, sample):
    monkeypatch.syspath_prepend(HERE)
    from ray_systems import Fatal

    trap = tmp_path / "trap"
    trap.touch()
    executor = build(RayConfig(workers=2))
    mended = estimate(executor, problem(Fatal(sample, str(trap))))
    assert not trap.exists()
    assert executor.restarts == 1
    np.testing.assert_array_equal(mended.robustness, estimate(SerialExecutor()).robustness)


@pytest.mark.usefixtures("cluster")
def test_what_kills_every_actor_is_named(monkeypatch):
    monkeypatch.syspath_prepend(HERE)
    from ray_systems import Fatal

    with pytest.raises(WorkerDied, match="in the probe before the estimate"):
        estimate(build(RayConfig(workers=2)), problem(Fatal(IN_THE_PROBE)))


@pytest.mark.usefixtures("cluster")
@pytest.mark.parametrize("end", ["dies", "hangs"])
def test_a_rollout_that_ends_its_actor_or_hangs_is_an_error(monkeypatch, end):
    monkeypatch.syspath_prepend(HERE)
    from ray_systems import Native

    raises = estimate(SerialExecutor(), problem(Native("raises")))
    executor = build(RayConfig(workers=2))
    native = estimate(executor, problem(Native(end), rollout_timeout=2.0))
    assert 0 < raises.errors == native.errors
    assert executor.restarts >= raises.errors
    np.testing.assert_array_equal(native.robustness, raises.robustness)


@pytest.mark.usefixtures("cluster")
def test_a_cluster_of_others_is_left_running():
    estimate(build(RayConfig()))
    assert ray.is_initialized()


@pytest.mark.usefixtures("no_cluster")
def test_a_local_cluster_leaves_no_trace():
    """Find no handler of a signal left either."""
    before = signal.signal(signal.SIGTERM, signal.SIG_IGN)
    try:
        one, two = estimate(SerialExecutor()), estimate(build(RayConfig(workers=2)))
        assert signal.getsignal(signal.SIGTERM) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGTERM, before)
    assert not ray.is_initialized()
    np.testing.assert_array_equal(one.robustness, two.robustness)
