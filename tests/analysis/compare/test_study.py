"""Comparison studies on problems with exact answers."""

from dataclasses import replace

import pytest

import avrare
from avrare.analysis.compare.case import ComparisonCase, GroundTruth, parse_truth
from avrare.analysis.compare.comparison import StudyDesign
from avrare.analysis.compare.estimator_options import parse_arms
from avrare.analysis.compare.study import run_study
from avrare.base.errors import UsageError
from avrare.estimation.plan.budget import Budget
from avrare.output.documents import comparison_document
from avrare.plugin.registry import default_registry
from avrare.testing.problems import conjunction, count_down

LATTICE = count_down(5, 9, "1/5")
STATIC = conjunction(-1.5)
SMALL = "ams:particles=40:discard=10"


def case(reference=LATTICE):
    return ComparisonCase(reference.id, "", reference.problem(), GroundTruth(reference.probability, "exact"))


def run(problem, estimators, budget="steps=9000", watch=None, truth_rollouts=None, **design):
    arms = parse_arms(estimators, [], None, default_registry())
    plan = StudyDesign(Budget.parse(budget), **{"repeat": 3, **design})
    return run_study(problem, arms, plan, watch or (lambda name, problem: lambda info: None), truth_rollouts)


def test_every_repetition_is_an_estimate_with_a_seed_of_its_own():
    comparison = run(case(), f"mc,{SMALL}", seed=5)
    for entry in comparison.arms:
        for seed, one in enumerate(entry.repetitions, 5):
            same = avrare.estimate(
                LATTICE.problem(), entry.arm.name, seed=seed, budget="steps=9000", **entry.arm.options
            )
            assert (one.probability, one.interval) == (same.probability, same.interval)
            assert (one.simulated_steps, one.health) == (same.simulated_steps, same.health)


def test_the_cost_counts_full_simulations():
    (mc, ams) = run(case(), f"mc,{SMALL}").summaries
    assert (mc.steps, mc.simulations) == (9000, 1000)
    assert ams.simulations == pytest.approx(ams.steps / LATTICE.steps)
    static = run(case(STATIC), "mc", budget="rollouts=500").summaries[0]
    assert (static.steps, static.simulations) == (0, 500)


def test_a_budget_that_pays_for_no_run_is_refused_before_anything_runs():
    begun = []
    with pytest.raises(UsageError, match="ams: a budget of steps=900 does not pay"):
        run(case(), "mc,ams", budget="steps=900", watch=lambda label, problem: begun.append(label))
    assert begun == []


def test_an_estimator_that_does_not_fit_gets_a_row_with_the_reason():
    comparison = run(case(), "mc,ce")
    mc, network = comparison.arms
    assert len(mc.repetitions) == 3
    assert network.repetitions == ()
    assert "perception" in str(network.refusal)
    assert comparison.summaries[1] is None
    assert "perception" in comparison_document(comparison)["estimators"][1]["refusal"]


def test_an_estimator_that_fails_midway_is_left_out_of_the_statistics():
    wrong = replace(case(), problem=LATTICE.problem(score="progress"))
    comparison = run(wrong, f"mc,{SMALL}")
    assert "progress" in str(comparison.arms[1].refusal)
    assert comparison.summaries[1] is None


def interrupt_at(name):
    def watch(begun, problem):
        if begun == name:
            raise KeyboardInterrupt
        return lambda info: None

    return watch


def test_an_interruption_keeps_finished_repetitions():
    comparison = run(case(), f"mc,{SMALL}", watch=interrupt_at("mc  3/3"))
    assert comparison.interrupted
    assert [len(entry.repetitions) for entry in comparison.arms] == [2, 2]
    full = run(case(), f"mc,{SMALL}")
    assert [one.probability for one in comparison.arms[1].repetitions] == [
        one.probability for one in full.arms[1].repetitions[:2]
    ]
    with pytest.raises(KeyboardInterrupt):
        run(case(), "mc", watch=interrupt_at("mc  1/3"))


def test_enough_failures_make_a_truth():
    unknown = replace(case(), truth=None)
    comparison = run(unknown, f"mc,{SMALL}")  # 3000 rollouts at 0.02: some 60 failures
    assert comparison.truth is None
    assert comparison.summaries[0].accuracy is None
    comparison = run(unknown, f"mc,{SMALL}", repeat=10)
    values = [one.probability for one in comparison.arms[0].repetitions]
    assert comparison.truth.source == "pooled monte carlo"
    assert comparison.truth.probability == pytest.approx(sum(values) / 10)
    assert comparison.truth.failures >= 100


def test_a_monte_carlo_run_of_its_own_finds_the_truth():
    truth = run(replace(case(), truth=None), SMALL, truth_rollouts=5000).truth
    assert (truth.source, truth.probability) == ("monte carlo", truth.failures / 5000)
    assert truth.interval[0] < LATTICE.probability < truth.interval[1]
    never = replace(case(conjunction(-3.0)), truth=None)
    with pytest.raises(UsageError, match="no rollout of 3 failed"):
        run(never, "mc", budget="rollouts=10", truth_rollouts=3)


def test_the_truth_in_words():
    assert parse_truth("1.2e-4") == GroundTruth(1.2e-4, "given")
    assert parse_truth("mc=1e6") == 1_000_000
    for text in ("0", "1", "nan", "inf", "mc=", "mc=0", "mc=1.5", "mc=inf", "ams=100", "=3", ""):
        with pytest.raises(UsageError, match=r"truth .*: should be a probability"):
            parse_truth(text)
