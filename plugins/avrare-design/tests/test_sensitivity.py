"""Sensitivity against exact derivatives of a closed loop."""

import math

import numpy as np
import pytest

import avrare
from avrare.analysis.causes.failure_sample import FailureSample
from avrare.analysis.causes.tape_runs import TapeRunner
from avrare.base.errors import UsageError
from avrare.estimation.loop.checkpoint import Checkpoint
from avrare.testing.faulty_systems import Walk
from avrare_design.scenario_numbers import ScenarioNumbers
from avrare_design.scenario_parameters import ParametricScenario
from avrare_design.sensitivity import Sensitivities, derive_by_pairs, derive_by_score, sample_failures
from noisy_loop import Sensor, exact, noisy_problem

SCENARIO = "scenarios/lane_change.yaml"


def by_score(rollouts, seed=1, build=Sensor):
    problem = noisy_problem(1.0)
    sample = sample_failures(problem, rollouts, seed, 0.95, TapeRunner())
    return derive_by_score(problem, sample, "perception.sd", 1.0, build)


def by_pairs(rollouts, seed=1, pair=None):
    pair = pair or (noisy_problem(gain=0.9), noisy_problem(gain=1.1))
    options = {"rollouts": rollouts, "seed": seed, "confidence": 0.95, "runner": TapeRunner()}
    return derive_by_pairs(pair, (0.9, 1.1), "controller.gain", 1.0, **options)


def test_the_score_function_gives_the_derivative():
    found, truth = by_score(20_000), exact()
    assert found.method == "score"
    low, high = found.interval
    assert low < truth.derivative < high
    assert high - low < 0.5 * truth.derivative
    assert found.derivative == pytest.approx(truth.derivative, rel=0.1)


def test_scores_that_a_journal_keeps_are_not_measured_again(tmp_path):
    problem = noisy_problem()
    sample = sample_failures(problem, 2000, 1, 0.95, TapeRunner())
    built = []

    def derive(numbers, factor=1.0):
        def build(value):
            built.append(value)
            return Sensor(value if value < 1.0 else factor * value)

        journal = Checkpoint.open(tmp_path / "kept", {"sample": 1}).journal("tapes")
        runner = TapeRunner(journal=journal)
        return [derive_by_score(problem, sample, f"sd{n}", 1.0, build, runner) for n in range(numbers)]

    whole = [derive_by_score(problem, sample, f"sd{n}", 1.0, Sensor) for n in range(3)]
    assert derive(2) == whole[:2]
    assert derive(3) == whole
    assert len(built) == 2 * (2 + 1 + 1)  # the first is measured again, to see that nothing has changed
    with pytest.raises(UsageError, match="do not reproduce"):
        derive(1, factor=1.1)


def test_pairs_give_the_quotient():
    truth = math.log(exact(1.1).p / exact(0.9).p) / 0.2
    found = by_pairs(20_000)
    low, high = found.interval
    assert low < truth < high
    assert high - low < 0.6 * truth


@pytest.mark.parametrize(("limit", "kept"), [(1.0, "below"), (0.0, "above")])
def test_the_score_at_the_end_of_a_range_is_one_sided(limit, kept):
    # At sd = 1, one side is not permitted; the step of a thousandth has no noise and hardly a bias.
    def build(value):
        if value > limit if kept == "below" else value < 1.0:
            raise UsageError(f"{value} is not permitted")
        return Sensor(value)

    found, whole = by_score(5000, build=build), by_score(5000)
    assert found.derivative == pytest.approx(whole.derivative, rel=5e-3)
    assert found.derivative != whole.derivative


def test_a_score_without_any_permitted_side_is_refused():
    def build(value):
        if value != 1.0:
            raise UsageError("only 1 is permitted")
        return Sensor(value)

    with pytest.raises(UsageError, match="no value beside it is permitted"):
        by_score(2000, build=build)


def test_pairs_that_break_down_are_no_passes():
    # The second value breaks down where the first noise number is positive, and changes nothing else.
    class Breaking(Walk):
        def faults(self, state):
            return state["x"] > 0.0

    formula = avrare.stl("always[1, 1] (x > -0.1)")
    pair = tuple(avrare.Problem(system, formula, steps=1) for system in (Walk(), Breaking()))
    found = by_pairs(400, pair=pair)
    low, high = found.interval
    assert found.derivative == 0.0
    # Half of all tapes might have failed at one value alone.
    assert low < -5.0 < 5.0 < high


def test_a_parameter_without_effect_has_an_interval_around_zero():
    found = by_pairs(2000, pair=(noisy_problem(), noisy_problem()))
    assert found.derivative == 0.0
    assert found.interval[0] < 0.0 < found.interval[1]


def test_the_line_says_what_ten_percent_do():
    found = by_score(4000)
    assert found.line().startswith("perception.sd = 1: +10 % changes p by +")
    assert found.elasticity == found.derivative


@pytest.mark.slow
@pytest.mark.parametrize("derive", [by_score, by_pairs])
def test_derivatives_are_unbiased_and_their_intervals_cover(derive):
    truth = exact().derivative if derive is by_score else math.log(exact(1.1).p / exact(0.9).p) / 0.2
    found = [derive(4000, seed) for seed in range(100)]
    values = np.array([one.derivative for one in found])
    error = values.std(ddof=1) / 10.0
    assert abs(values.mean() - truth) < max(0.02 * truth, 3.0 * error)
    assert error < 0.02 * truth
    assert sum(one.interval[0] <= truth <= one.interval[1] for one in found) >= 89


@pytest.mark.slow
def test_weighted_failures_give_the_derivative_too():
    problem = noisy_problem(limit=7.0)
    truth = exact(limit=7.0)
    result = avrare.estimate(problem, "is", seed=2, runs=2)
    found = derive_by_score(problem, FailureSample.of(result), "perception.sd", 1.0, Sensor)
    assert found.interval[0] < truth.derivative < found.interval[1]


@pytest.fixture(scope="module")
def lane_change():
    settings = ["steps=30", "controller.horizon=8", "specifications.near={stl: 'always (ego_y < 1.76)'}"]
    parameters = ["perception.miss_scale", "tracker.gate"]
    return avrare.sensitivity(SCENARIO, parameters, "near", overrides=settings, rollouts=16)


def test_a_scenario_takes_the_method_that_fits(lane_change):
    methods = {row.parameter: row.method for row in lane_change.rows}
    assert methods == {"perception.miss_scale": "score", "tracker.gate": "paired"}
    assert lane_change.rollouts == 48
    assert [row["parameter"] for row in lane_change.table()] == [row.parameter for row in lane_change.rows]


def test_a_number_that_decides_what_can_happen_at_all_is_compared_in_pairs():
    settings = ["steps=6", "controller.horizon=8", "specifications.near={stl: 'always (ego_x < 8)'}"]
    settings += ["perception.plugin=parametric"]
    found = avrare.sensitivity(SCENARIO, ["perception.error_limit"], "near", overrides=settings, rollouts=4)
    assert [row.method for row in found.rows] == ["paired"]


@pytest.mark.parametrize("parameter", ["perception.mis_scale", "perception.model"])
def test_what_is_no_number_is_refused(parameter):
    with pytest.raises(UsageError, match=f"'{parameter}' is not a number"):
        avrare.sensitivity(SCENARIO, [parameter], "no_collision", rollouts=10)


TANK = """\
name: tank
steps: 5
simulator: {{plugin: tank, start: {start}, rim: {rim}, surge: 0.8}}
specifications:
  dry: {{stl: "always (level < {limit})"}}
"""


def tank(tmp_path, parameter="simulator.start", start=1.0, rim=2.0, limit=1.2, **options):
    path = tmp_path / "tank.yaml"
    path.write_text(TANK.format(start=start, rim=rim, limit=limit))
    return avrare.sensitivity(path, [parameter], rollouts=400, **options).rows[0]


def test_a_step_beyond_what_the_parts_permit_is_shortened(tmp_path):
    # The tank that is built refuses a start above the rim; the schema does not know.
    row = tank(tmp_path, start=1.0, rim=1.03, limit=1.028)
    assert row.span == pytest.approx((0.9, 1.025))
    assert row.refused == pytest.approx((1.1,))
    assert row.line().endswith("by paired from 0.9 to 1.025 (1.1 is not permitted)")
    low, high = row.interval
    assert low < row.derivative < high


def test_at_the_end_of_the_range_the_comparison_is_one_sided(tmp_path):
    row = tank(tmp_path, start=0.0, limit=0.3)
    assert row.span == pytest.approx((0.0, 0.1))
    assert row.refused == pytest.approx((-0.1,))
    entry = row.line()
    assert "from 0 to 0.1 (-0.1 is not permitted)" in entry


def test_a_parameter_that_may_not_move_is_refused(tmp_path):
    path = tmp_path / "tank.yaml"
    path.write_text(TANK.format(start=1e-9, rim=0.02, limit=0.015))
    with pytest.raises(UsageError, match="permits no value beside it") as caught:
        avrare.sensitivity(path, ["simulator.start"], rollouts=20, step=1e9)
    assert "above the rim" in caught.value.hint


def test_numbers_in_a_list_that_is_a_default_can_be_changed():
    # The file does not have the list: `--set` alone cannot change one entry of it.
    scenario = ParametricScenario(SCENARIO, ("perception={plugin: parametric}",))
    first, second = (f"perception.longitudinal_scale.{k}" for k in range(2))
    assert {first, second} < set(scenario.default_parameters())

    def scale(loaded):
        return loaded.definition.resolved["perception"]["longitudinal_scale"]

    assert scale(scenario.at(second, 0.007)) == [0.047, 0.007]
    numbers = ScenarioNumbers.of(scenario, [first, second])
    assert scale(numbers.at(np.array([0.05, 0.008]))) == [0.05, 0.008]


def test_a_change_without_failures_is_not_known():
    row = by_pairs(3)
    assert row.line().startswith("controller.gain = 1: not known, p at most 0.71 at both values")
    *_, hint = Sensitivities("rule", 1e-4, (0.0, 1e-3), (row,), 6, 0).lines()
    assert "some 500,000 rollouts tell, or avrare compare --estimators auto" in hint
    known = Sensitivities("rule", 0.1, (0, 1), (by_pairs(4000),), 6, 0)
    assert not any("hint" in line for line in known.lines())
