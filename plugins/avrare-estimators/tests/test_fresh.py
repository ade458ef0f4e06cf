"""The blind bound: what all fresh rows of the target say of failures that the score does not lead to."""

import numpy as np
import pytest

import avrare
from avrare.estimation.loop.loop import run
from avrare.estimation.plan.plan import Settings
from avrare.estimation.result import intervals
from avrare.estimation.result.fresh_rows import FreshRows
from avrare.plugin.registry import default_registry
from avrare.rollout.executors.serial import SerialExecutor
from avrare.testing import faulty_systems as systems
from avrare.testing.problems import reference_problem

SIZES = {
    "ams": {"particles": 40, "discard": 8, "runs": 3},
    "ess": {"chains": 6, "runs": 3, "level_probability": 0.2},
    "is": {"rollouts": 300, "proposal": {"name": "gaussian", "mean": 0.3}},
}
LIKELY = reference_problem("d_rw_L2.5").problem()
NEVER = avrare.Problem(systems.Walk(), avrare.stl("always (x < 1e9)"), 20)


def bound(failures, rows):
    return intervals.clopper_pearson(failures, rows, 0.95)[1]


@pytest.mark.parametrize(("name", "rows"), [("ams", 3 * 40), ("ess", 3 * 5 * (5 + 6))])
def test_all_fresh_rows_count(name, rows):
    assert avrare.estimate(NEVER, name, **SIZES[name]).blind_bound == bound(0, rows)


@pytest.mark.parametrize("name", [*SIZES, "smc"])
def test_rows_from_before_the_estimate_count_in_the_bound_alone(name):
    """Give all but ``smc`` a problem that they estimate at 0, so that the interval is the bound too."""
    options = SIZES.get(name) or {"particles": 100, "runs": 3, "pilot": 400, "stages": 1}
    estimator, task = default_registry().get("estimator", name), NEVER if name in SIZES else LIKELY

    def run_after(seen):
        built = estimator.load_factory()(estimator.load_config()(**options), None)
        (result,) = run(task, built, SerialExecutor(), Settings(seed=1, seen=seen))
        return result

    alone, after = run_after(FreshRows()), run_after(FreshRows(100_000, 2))
    assert after.run_probabilities.tolist() == alone.run_probabilities.tolist()
    assert bound(2, 110_000) < after.blind_bound < bound(50, 100_000) < alone.blind_bound
    if name in SIZES:
        assert after.interval[1] < alone.interval[1]


@pytest.mark.slow
def test_fresh_failures_raise_the_bound():
    result = avrare.estimate(LIKELY, "ams", particles=400, discard=40, runs=2)
    failures = int((result.robustness <= 0.0).sum())
    assert failures > 0
    assert result.blind_bound == bound(failures, 800)


@pytest.mark.parametrize("name", SIZES)
def test_the_bound_holds_where_the_score_shows_nothing(name):
    class Flat(systems.Walk):
        """A walk whose signal is 0 below its limit."""

        def signals(self, state):
            return {"x": np.where(super().signals(state)["x"] >= 1.2, 2.0, 0.0)}

    problem = avrare.Problem(Flat(), avrare.stl("always (x < 1)"), 20)
    truth = avrare.estimate(problem, "mc", rollouts=4000).probability
    assert avrare.estimate(problem, name, **SIZES[name]).blind_bound > truth


def test_an_estimate_of_0_has_the_bound_of_all_fresh_rows():
    rows = FreshRows(rows=200, failures=1, errors=2)
    assert rows.interval_of_zero()(0.9) == intervals.clopper_pearson(0, 200, 0.9, errors=3)
    assert FreshRows().interval_of_zero()(0.9) == (0.0, 1.0)
