"""Verdicts on criteria, and their error rates."""

from dataclasses import replace

import numpy as np
import pytest

from avrare.analysis.check.criteria import (
    Criterion,
    assess,
    decide_criteria,
    find_assumption,
    find_objections,
)
from avrare.analysis.check.pooling import pool
from avrare.analysis.check.targets import SHARES, plan_looks
from avrare.estimation.plan.budget import Budget
from avrare.estimation.result.confidence_distributions import Binomial, LogNormal
from avrare.estimation.result.verdict import judge
from avrare.scenario.schema import Regression, Threshold


def threshold(bound, confidence=0.95, name="rule"):
    return Criterion("s", name, Threshold(specification=name, probability=bound, confidence=confidence))


@pytest.fixture
def against(estimate):
    """Return maker of regression criteria against a baseline with a given law."""

    def against(law, name="rule", health=None, **criterion):
        entry = estimate(law, health=health or {})
        return Criterion("s", name, Regression(**criterion), entry)

    return against


@pytest.fixture
def decide(estimate):
    """Return verdict on one criterion, for a law or a result."""

    def decide(criterion, law, share=1.0, **changes):
        result = estimate(law, **changes)
        return decide_criteria([criterion], lambda _: result, share, {}).get(0, "inconclusive")

    return decide


@pytest.mark.parametrize(
    "law",
    [Binomial(0, 4000), Binomial(3, 4000), Binomial(40, 4000), Binomial(90, 4000), LogNormal(2e-3, 0.1, 9),
     LogNormal(0.03, 0.1, 9)],
)  # fmt: skip
@pytest.mark.parametrize("bound", ["< 1e-3", "<= 1e-2", "< 0.8", "<= 0", "< 0"])
@pytest.mark.parametrize("confidence", [0.5, 0.95, 0.99])
@pytest.mark.parametrize("warnings", [(), ("few_roots",), ("solver_failures",)])
def test_one_threshold_alone_is_decided_as_run_decides_it(decide, estimate, law, bound, confidence, warnings):
    criterion, health = threshold(bound, confidence), dict.fromkeys(warnings, "...")
    assert decide(criterion, law, health=health) == judge(estimate(law, health=health), criterion.condition)


@pytest.mark.parametrize(
    ("blind_bound", "blind", "verdict"),
    [
        (None, "counted", "pass"),
        (5e-4, "counted", "pass"),
        (1e-3, "assumed", "pass_assuming"),
        (2e-3, "assumed", "pass_assuming"),
        (2e-3, "counted", "inconclusive"),
    ],
)
def test_a_threshold_knows_what_was_not_looked_for(estimate, blind_bound, blind, verdict):
    result = replace(estimate(LogNormal(1e-5, 0.1, 9)), blind_bound=blind_bound)
    condition = Threshold(specification="safe", probability="< 1e-3", blind=blind)
    assert judge(result, condition) == verdict
    criterion = Criterion("scenario", "safe", condition)
    verdicts = decide_criteria([criterion], lambda _: result, 1.0, {})
    assert verdicts.get(0, "inconclusive") == verdict
    assert bool(find_assumption(criterion, result)) == (verdict != "pass")


def test_a_blind_bound_turns_no_failing_threshold(estimate):
    result = replace(estimate(LogNormal(0.1, 0.1, 9)), blind_bound=0.5)
    condition = Threshold(specification="safe", probability="< 1e-3")
    assert judge(result, condition) == "fail"


def test_regressions(decide, against):
    before = Binomial(40, 4000)
    assert decide(against(before), Binomial(80, 4000)) == "fail"
    assert decide(against(before), Binomial(40, 4000)) == "pass"
    assert decide(against(before), Binomial(55, 4000)) == "inconclusive"
    assert decide(against(before, ratio=1.5), Binomial(80, 4000)) == "pass"
    assert decide(against(before, ratio=1.5), Binomial(84, 4000)) == "inconclusive"
    assert decide(against(before, ratio=1.5), Binomial(120, 4000)) == "fail"
    assert decide(against(before, exclude=1.5), Binomial(40, 4000)) == "inconclusive"
    assert decide(against(before, confidence=0.99999), Binomial(80, 4000)) == "inconclusive"
    assert decide(against(LogNormal(1e-4, 0.01, 9)), LogNormal(2e-4, 0.01, 9)) == "fail"
    assert decide(against(LogNormal(1e-2, 0.01, 9)), Binomial(80, 4000)) == "fail"


def test_zero_counts(decide, against):
    assert decide(against(Binomial(0, 4000)), Binomial(0, 4000)) == "pass"
    assert decide(against(Binomial(0, 4000)), Binomial(0, 1000)) == "inconclusive"
    assert decide(against(Binomial(0, 4000)), Binomial(1, 4000)) == "inconclusive"
    assert decide(against(Binomial(0, 4000)), Binomial(9, 4000)) == "fail"
    assert decide(against(Binomial(9, 4000)), Binomial(0, 4000)) == "pass"
    assert decide(against(Binomial(1, 4000)), Binomial(0, 4000)) == "inconclusive"


def test_an_uninformative_estimate_never_passes(decide, estimate, against):
    unknown = {"interval_at": lambda confidence: (0.0, 1.0), "probability": 0.0}
    entry = estimate(**unknown)
    criterion = Criterion("s", "rule", Regression(), entry)
    assert decide(criterion, None, **unknown) == "inconclusive"
    assert decide(threshold("< 0.9"), None, **unknown) == "inconclusive"


def test_an_unhealthy_estimate_neither_passes_nor_fails(decide, against, estimate):
    ill = {"health": {"few_roots": "half of the runs ..."}}
    assert decide(threshold("< 0.5"), Binomial(5, 1000)) == "pass"
    assert decide(threshold("< 0.5"), Binomial(5, 1000), **ill) == "inconclusive"
    assert decide(threshold("< 1e-4"), Binomial(5, 1000), **ill) == "inconclusive"
    assert decide(threshold("< 1e-4"), Binomial(5, 1000)) == "fail"
    sick = against(Binomial(40, 4000), health={"extinct": "..."})
    assert decide(sick, Binomial(40, 4000)) == "inconclusive"
    assert decide(sick, Binomial(400, 4000)) == "inconclusive"
    assert find_objections(sick, estimate(Binomial(40, 4000))) == [
        "the baseline has health warnings: extinct"
    ]


def test_a_warning_about_the_system_leaves_a_failure_a_failure(decide):
    for name in ("all_failed", "solver_failures", "errors"):
        assert decide(threshold("< 0.1"), Binomial(1000, 1000), health={name: "..."}) == "fail"
        assert decide(threshold("< 0.1"), Binomial(0, 1000), health={name: "..."}) == "inconclusive"


def test_another_definition_of_failure_is_not_compared(decide, against, estimate):
    criterion, other = against(Binomial(40, 4000)), {"relation": "robustness <= 0"}
    for failures in (0, 40, 4000):
        assert decide(criterion, Binomial(failures, 4000), **other) == "inconclusive"
    (doubt,) = find_objections(criterion, estimate(Binomial(40, 4000), **other))
    assert doubt == "failure is robustness <= 0 here, violated in the baseline"


def test_with_several_criteria_a_failure_needs_more_evidence(estimate):
    criteria = [threshold("< 5e-3", name=name) for name in "abc"]
    results = {name: estimate(Binomial(60, 9000)) for name in "abc"}
    alone = decide_criteria(criteria[:1], lambda criterion: results[criterion.specification], 1.0, {})
    assert alone == {0: "fail"}
    results["b"] = results["c"] = estimate(Binomial(30, 9000))
    both = decide_criteria(criteria, lambda criterion: results[criterion.specification], 1.0, {})
    assert 0 not in both
    results["b"] = results["c"] = estimate(Binomial(400, 9000))
    assert decide_criteria(
        criteria, lambda criterion: results[criterion.specification], 1.0, {}
    ) == dict.fromkeys(range(3), "fail")


def test_holm_never_fails_less_than_bonferroni_and_keeps_the_family_wise_rate(estimate):
    rng = np.random.default_rng(1)
    bound, error = 0.01, 0.1  # of the logarithm
    criteria = [threshold(bound, name=str(number)) for number in range(6)]
    alarms = steps = 0
    for _ in range(400):
        logs = error * rng.standard_normal(6) + [0, 0, 0, 0, 0.3, 0.3]
        results = [estimate(LogNormal(bound * np.exp(shift), np.expm1(error**2), 0)) for shift in logs]
        found = decide_criteria(criteria, lambda criterion: results[int(criterion.specification)], 1.0, {})  # noqa: B023
        p_values = [
            assess(criterion, result, 1.0).normalised_p_value
            for criterion, result in zip(criteria, results, strict=True)
        ]
        bonferroni = {number for number, p_value in enumerate(p_values) if p_value <= 1 / 6}
        failed = {number for number, name in found.items() if name == "fail"}
        assert bonferroni <= failed
        steps += len(failed - bonferroni)
        alarms += bool(failed & set(range(4)))
    assert alarms <= 20  # 2.5 % of 400 are 10; more than 20 have a chance of 0.1 %
    assert steps > 0


def test_decided_verdicts_stay(estimate):
    criteria = [threshold("< 5e-3", name="a"), threshold("< 5e-3", name="b")]
    bad, good = estimate(Binomial(200, 9000)), estimate(Binomial(2, 9000))
    first = decide_criteria(
        criteria, lambda criterion: {"a": bad, "b": good}[criterion.specification], 0.5, {}
    )
    assert first == {0: "fail", 1: "pass"}
    assert (
        decide_criteria(
            criteria, lambda criterion: {"a": good, "b": bad}[criterion.specification], 0.5, first
        )
        == first
    )


def test_a_criterion_without_an_estimate_stays_undecided():
    assert decide_criteria([threshold("< 0.1")], lambda _: None, 1.0, {}) == {}


def test_looks_share_budget_and_error_rate():
    planned = plan_looks(Budget("rollouts", 8000), several=True)
    assert [one.budget.amount for one in planned] == [1000, 1000, 2000, 4000]
    assert sum(one.share for one in planned) == 1.0
    assert len({one.seed(7) for one in planned}) == 4
    assert planned[0].seed(7) == 7
    assert all(0 <= one.seed(2**63 - 1) < 2**63 for one in planned)
    (only,) = plan_looks(Budget("steps", 10))
    assert (only.share, only.budget.amount) == (1.0, 10)


@pytest.mark.slow
@pytest.mark.parametrize("probability", [0.05, 0.12])
def test_several_looks_keep_the_error_rate_and_the_power(estimate, probability):
    rng = np.random.default_rng(2)
    criterion, failed, looks = threshold("< 0.05"), 0, 0
    for _ in range(200):
        batches, found = [], {}
        for share in SHARES:
            trials = int(1600 * share)
            batches.append(estimate(Binomial(int(rng.binomial(trials, probability)), trials)))
            found = decide_criteria([criterion], lambda _: pool(batches, 0.01), share, found)  # noqa: B023
            if found:
                break
        failed += found.get(0) == "fail"
        looks += len(batches)
    if probability == 0.05:
        assert failed <= 12  # 5 are 2.5 %; more than 12 have a chance of 0.2 %
    else:
        assert failed == 200
        assert looks < 2.5 * 200
