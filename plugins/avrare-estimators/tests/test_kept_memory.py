"""The option ``memory``: what is foretold is about what is held, and the numbers do not depend on it."""

import tracemalloc

import numpy as np
import pytest

import avrare
from avrare.estimation.estimate import _config, _estimator
from avrare.estimation.loop.loop import run
from avrare.estimation.loop.preflight import build_plan
from avrare.estimation.plan import memory
from avrare.estimation.plan.plan import Settings
from avrare.rollout.executors.serial import SerialExecutor
from avrare.testing.faulty_systems import Walk

STEPS = 40
SIZES = {
    "mc": {"rollouts": 3000},
    "ams": {"particles": 300, "discard": 100, "runs": 3},
    "ess": {"chains": 30, "runs": 3},
    "is": {"rollouts": 3000, "proposal": {"name": "gaussian", "mean": 0.05, "std": 1.0}},
    "smc": {"particles": 600, "runs": 3, "pilot": 600},
}


class Wide(Walk):
    """A random walk whose noise has numbers that do nothing."""

    noise_size = 4


def problem(limit=1.0, chunk=200, steps=STEPS):
    return avrare.Problem(Wide(), avrare.stl(f"always (x < {limit})"), steps=steps, chunk=chunk)


def estimated(name, **options):
    estimator = _estimator(name, _config(name, {**SIZES[name], **options}))
    prepared, plan = build_plan(problem(), estimator, Settings(seed=3))
    foretold = memory.forecast(estimator, plan, memory.measure_carry(prepared))
    tracemalloc.start()
    try:
        (result,) = run(problem(), estimator, SerialExecutor(), Settings(seed=3))
        return result, tracemalloc.get_traced_memory()[1], foretold
    finally:
        tracemalloc.stop()


@pytest.mark.slow
@pytest.mark.parametrize("name", SIZES)
def test_an_estimate_holds_about_what_is_foretold(name):
    _, peak, foretold = estimated(name)
    assert foretold.held / 4 < peak < 1.2 * (foretold.held + foretold.chunk)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "mebibytes"), [("ams", 1.5), ("ess", 2)])
def test_runs_come_in_batches_that_fit(name, mebibytes):
    """Let only the numbers that tell of the cost differ: runs know nothing of each other."""
    whole, most, _ = estimated(name)
    result, peak, foretold = estimated(name, memory=mebibytes)
    assert foretold.held <= mebibytes * 2**20
    assert peak < 0.8 * most
    assert result.run_probabilities.tolist() == whole.run_probabilities.tolist()
    assert result.interval == whole.interval
    assert result.diagnostics["roots"] == whole.diagnostics["roots"]
    np.testing.assert_array_equal(result.worst.noise, whole.worst.noise)
    assert (result.failures.count, result.health) == (whole.failures.count, whole.health)


@pytest.mark.parametrize("name", SIZES)
def test_too_little_memory_is_refused_with_what_would_do(name):
    with pytest.raises(avrare.UsageError, match=r"memory \(0.01 MiB\)") as refused:
        avrare.estimate(problem(), name, memory=0.01, **SIZES[name])
    assert "raise it to " in refused.value.hint
    assert refused.value.hint.split("lower ")[1] in ("rollouts", "particles", "chains", "pilot")


def test_the_value_that_is_named_is_enough():
    with pytest.raises(avrare.UsageError) as refused:
        avrare.estimate(problem(steps=5), "ams", memory=0.01, runs=2, particles=50, discard=10)
    enough = int(refused.value.hint.split("raise it to ")[1].split(",")[0])
    result = avrare.estimate(problem(0.3, steps=5), "ams", memory=enough, runs=2, particles=50, discard=10)
    assert result.probability > 0.0


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("ams", {"particles": 10**9}),
        ("ess", {"chains": 1_000_000}),
        ("mc", {"rollouts": 10**15, "relative_error": 0.01}),
        ("is", {**SIZES["is"], "rollouts": 10**12}),
    ],
)
def test_what_the_machine_cannot_hold_is_refused_at_once(monkeypatch, name, options):
    monkeypatch.setattr(memory, "usable_memory", lambda: 4.0 * 2**30)
    words = r"needs about [\d.,]+ GiB of memory, and this process may use 4.0 GiB"
    with pytest.raises(avrare.UsageError, match=words):
        avrare.estimate(problem(steps=2000), name, **options)


def test_without_the_option_a_large_run_is_not_refused(monkeypatch):
    monkeypatch.setattr("avrare.base.memory.MOST_BY_DEFAULT", 0.01)
    result = avrare.estimate(problem(0.3, steps=5), "ams", runs=2, particles=50, discard=10)
    assert result.probability > 0.0
