"""The loop: progress, budgets, verdicts."""

import numpy as np
import pytest

import avrare
import odd_systems
from avrare.base.errors import UsageError
from avrare.estimation.loop.loop import run
from avrare.estimation.monte_carlo.config import McConfig
from avrare.estimation.monte_carlo.monte_carlo import MonteCarlo
from avrare.estimation.plan.budget import Budget
from avrare.estimation.plan.plan import Settings
from avrare.estimation.result.verdict import judge
from avrare.rollout.executors.serial import SerialExecutor
from avrare.scenario.schema import Threshold
from avrare.testing import faulty_systems as systems


def problem(limit=0.5, system=None, **keywords):
    return avrare.Problem(system or systems.Walk(), avrare.stl(f"always (x < {limit})"), steps=20, **keywords)


def monte_carlo(task, settings=None, progress=None, **options):
    return run(task, MonteCarlo(McConfig(**options)), SerialExecutor(), settings or Settings(), progress)


def test_progress_counts_every_chunk():
    seen = []
    task = problem(chunk=10, system=odd_systems.Odometer())
    (result,) = monte_carlo(task, progress=seen.append, rollouts=95)
    rollouts = [info.rollouts for info in seen]
    assert rollouts == sorted(rollouts)
    assert set(rollouts) == {10, 20, 30, 40, 50, 60, 70, 80, 90, 95}
    assert seen[-1].failures == result.failures.count > 0
    assert seen[-1].counts == result.counts == {"steps": 95 * 20}
    assert {info.goal for info in seen} == {95}


def test_all_specifications_share_one_pass():
    formulas = {"low": avrare.stl("always (x < 0.3)"), "high": avrare.stl("always (x < 0.9)")}
    system = systems.Counting(systems.Walk())
    low, high = monte_carlo(avrare.Problem(system, formulas, steps=20), rollouts=500)
    # their least robust rollout is the same, and is replayed once
    assert system.rows == 500 * 20 + odd_systems.rows_of_checks(systems.Walk(), 20)
    assert (low.specification, high.specification) == ("low", "high")
    assert low.probability > high.probability > 0.0
    for name, result in (("low", low), ("high", high)):
        (alone,) = monte_carlo(avrare.Problem(systems.Walk(), {name: formulas[name]}, steps=20), rollouts=500)
        assert alone.probability == result.probability
        np.testing.assert_array_equal(alone.failures.noise, result.failures.noise)


def test_an_estimator_of_one_specification_refuses_two():
    estimator = MonteCarlo(McConfig())
    estimator.single = True
    formulas = {name: avrare.stl("always (x < 1)") for name in ("a", "b")}
    with pytest.raises(avrare.UsageError, match="one specification at a time"):
        run(avrare.Problem(systems.Walk(), formulas, steps=2), estimator, SerialExecutor(), Settings())


def test_every_specification_passes_the_pre_flight_before_the_first_rollout(monkeypatch):
    class Choosy(MonteCarlo):
        single = True

        def prepare(self, problem):
            if problem.names == ("high",):
                raise avrare.UsageError("not that one")
            return problem

        def ask(self, state):
            pytest.fail("a rollout was asked for")

    formulas = {"low": avrare.stl("always (x < 0.3)"), "high": avrare.stl("always (x < 0.9)")}
    task = avrare.Problem(systems.Walk(), formulas, steps=20)
    monkeypatch.setattr("avrare.estimation.estimate._estimator", lambda name, options: Choosy(McConfig()))
    with pytest.raises(avrare.UsageError, match="not that one"):
        avrare.estimate_all(task)


def test_the_executor_is_closed_whatever_happens():
    class Executor(SerialExecutor):
        closed = False

        def close(self):
            self.closed = True

    class Wrong(systems.Walk):
        def signals(self, state):
            return {}

    executor = Executor()
    with pytest.raises(avrare.UsageError):
        run(problem(system=Wrong()), MonteCarlo(McConfig()), executor, Settings())
    assert executor.closed


def test_max_error_rate_is_a_setting():
    task = problem(system=systems.Fragile("nan", beyond=2.5))
    assert "errors" in monte_carlo(task, Settings(max_error_rate=0.01))[0].health
    (tolerant,) = monte_carlo(task, Settings(max_error_rate=0.5))
    assert tolerant.errors > 0
    assert not tolerant.health
    (note,) = (note.text for note in tolerant.notes if note.kind == "errors")
    assert note.startswith(f"An error ended {tolerant.errors} of {tolerant.rollouts:,} rollouts")


def bound(sign, limit, confidence=0.95):
    return Threshold(specification="any", probability=f"{sign} {limit!r}", confidence=confidence)


@pytest.mark.parametrize(("factor", "expected"), [(2.0, "pass"), (0.5, "fail"), (1.0, "inconclusive")])
def test_verdict(factor, expected):
    (result,) = monte_carlo(problem(1.0), rollouts=2000)
    assert judge(result, bound("<", factor * result.probability)) == expected


def test_verdict_asks_for_the_interval_at_its_own_confidence():
    (result,) = monte_carlo(problem(1.0), rollouts=2000)
    between = (result.interval[1] + result.interval_at(0.9999)[1]) / 2
    assert judge(result, bound("<", between)) == "pass"
    assert judge(result, bound("<", between, 0.9999)) == "inconclusive"


class Forgetful(systems.Walk):
    """Its rows depend on how often it was asked: no function of its noise."""

    calls = 0

    def step(self, state, noise):
        self.calls += 1
        return {"x": super().step(state, noise)["x"] + 1e-6 * self.calls}


class Solving(systems.Walk):
    """Reports a solver's counters, one solve in ten failing."""

    def initial(self, noise):
        return {"x": np.zeros(len(noise)), "n": np.zeros(len(noise), dtype=np.int64)}

    def step(self, state, noise):
        return {"x": state["x"] + 0.1 * noise[:, 0], "n": state["n"] + 10}

    def counts(self, state):
        return {"solves": state["n"], "fallback_solves": state["n"] // 10}


def test_a_system_that_is_not_a_function_of_its_noise_is_detected():
    (result,) = monte_carlo(problem(system=Forgetful()), rollouts=50)
    assert "not_deterministic" in result.health
    (healthy,) = monte_carlo(problem(), rollouts=50)
    assert not healthy.health
    (broken,) = monte_carlo(problem(system=systems.Fragile("nan", beyond=-9.0)), rollouts=20)
    assert list(broken.health) == ["errors"]


def test_a_formula_beyond_the_end_and_a_failing_solver_give_warnings():
    task = avrare.Problem(Solving(), avrare.stl("always[0:30] (x < 0.5)"), steps=20)
    result = avrare.estimate(task, rollouts=50)
    assert set(result.health) == {"horizon_short", "solver_failures"}
    assert "30 samples ahead but a rollout ends after 20" in result.health["horizon_short"]
    assert "1000 of 10000 solves" in result.health["solver_failures"]


def test_warnings_can_be_suppressed_by_name():
    task = avrare.Problem(Solving(), avrare.stl("always[0:30] (x < 0.5)"), steps=20)
    result = avrare.estimate(task, rollouts=50, suppress=["horizon_short"])
    assert set(result.health) == {"solver_failures"}
    with pytest.raises(avrare.UsageError, match="unknown health warning 'horizon'"):
        avrare.estimate(task, suppress=["horizon"])
    with pytest.raises(avrare.UsageError, match="cannot be suppressed"):
        avrare.estimate(task, suppress="errors")  # a string is one name


@pytest.mark.parametrize("amount", [1e16, 1e30, float("inf"), float("nan"), 0.0, -1.0])
@pytest.mark.parametrize("kind", ["steps", "rollouts", "seconds"])
def test_a_budget_beyond_reason_is_refused(kind, amount):
    with pytest.raises(UsageError, match="must be a positive number up to 1e"):
        Budget(kind, amount)
    assert Budget.parse(f"{kind}=1e15") == Budget(kind, 1e15)
