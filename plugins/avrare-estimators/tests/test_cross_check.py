"""Weighted estimates do not vouch for themselves: target rows and a climb of their own must agree."""

import numpy as np
import pytest

import avrare
from avrare.testing.problems import reference_problem
from avrare_estimators.common.samples.agreement import compare_checks
from avrare_estimators.common.samples.cross_check import GROUPS, CrossCheckResult
from plain_systems import Static

LINE = reference_problem("b_linear_d100_p1e-4")
OWN = (0.9e-4, 1.1e-4)


def check(around, scatter=1.1):
    return CrossCheckResult(tuple(around * scatter ** np.linspace(-1.0, 1.0, GROUPS)), rollouts=4000)


def doubts(checks):
    return compare_checks(1e-4, OWN, 0.05, checks, 0.95)[0]


def test_a_check_that_agrees_raises_no_doubt():
    assert doubts([check(1.05e-4)]) == {}
    assert doubts([check(1.05e-4), None, check(0.9e-4)]) == {}
    assert doubts([]) == {}


def test_a_check_that_vouches_states_its_power():
    (note,) = compare_checks(1e-4, OWN, 0.05, [check(1.05e-4)], 0.95)[1]
    assert note.kind == "witness"
    assert "would have been noticed in 100 of 100" in note.text
    (weaker,) = compare_checks(1e-4, (0.5e-4, 2e-4), 0.35, [check(1.05e-4, scatter=1.8)], 0.95)[1]
    assert int(weaker.text.split(" in ")[1].split()[0]) < 90


def test_a_climb_that_contradicts_is_told_with_both_numbers():
    for around, number in ((3e-4, "3.0e-04"), (3e-5, "3.0e-05")):
        found = doubts([check(around)])
        assert list(found) == ["contradicted"]
        assert f"the cross-check says {number} (" in found["contradicted"]
        assert "the weighted sample says 1.0e-04 (9.0e-05 .. 1.1e-04)" in found["contradicted"]


@pytest.mark.parametrize(
    ("checks", "reason"),
    [
        ([None], "did not reach a failure"),
        ([None, check(1e-4)], "did not reach a failure"),
        ([CrossCheckResult((), 900)], "did not reach a failure"),
        ([CrossCheckResult((0.0,) * GROUPS, 900)], "died out"),
        ([check(0.3e-4, scatter=30.0)], "vouches for little: a miss by a factor 3"),
    ],
)
def test_a_check_without_an_answer_does_not_vouch(checks, reason):
    assert reason in doubts(checks)["unchecked"]


def test_a_proposal_that_misses_a_mode_is_contradicted():
    """Fail at z1 >= 4.0, or at z2 <= -3.6, which shows only shortly before."""
    truth, system = 1.90777e-4, Static(2, lambda z: np.maximum(z[:, 0] / 4.0, np.exp(-4.0 * (z[:, 1] + 3.6))))
    problem = avrare.Problem(system, avrare.stl("x < 1"), 0)
    result = avrare.estimate(problem, "is", seed=2, proposal={"name": "gaussian", "mean": [4.0, 0.0]})
    assert result.probability < truth / 3.0
    assert {"contradicted", "unchecked"} & set(result.health)
    assert result.interval[0] <= result.probability < truth <= result.interval[1]


@pytest.mark.parametrize("seed", range(2))
def test_the_check_is_a_small_part_of_the_cost(seed):
    result = avrare.estimate(reference_problem("a_beta_-2").problem(), "is", seed=seed)
    assert 0 < result.diagnostics["check_rollouts"] <= 0.15 * result.rollouts


def test_a_check_that_ends_without_an_answer_is_paid_for():
    for seed in range(3):
        spent = avrare.estimate(LINE.problem(), "is", seed=seed, rollouts=4000, check=0.4).diagnostics
        (look,) = spent["second_look"]
        assert spent["check_rollouts"] == (0 if look is None else look["rollouts"])


def test_a_check_whose_starts_fail_is_done_at_once():
    system = Static(60, lambda z: z.sum(axis=1) / 60**0.5)
    proposal = {"name": "gaussian", "mean": [1.25 / 60**0.5] * 60}
    problem = avrare.Problem(system, avrare.stl("x < 1.25"), 0)
    result = avrare.estimate(problem, "is", seed=1, rollouts=8000, proposal=proposal)
    (look,) = result.diagnostics["second_look"]
    assert look["rollouts"] == 0
    assert np.mean(look["probabilities"]) == pytest.approx(0.1056, rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["a_beta_-2", "d_rw_L3.8", "c_fourbranch_k7"])
def test_the_climb_is_right_on_its_own(name):
    problem = reference_problem(name)
    results = [avrare.estimate(problem.problem(), "is", seed=seed) for seed in range(8)]
    looks = [look for result in results for look in result.diagnostics["second_look"] if look is not None]
    assert len(looks) >= 7
    means = np.array([np.mean(look["probabilities"]) for look in looks]) / problem.probability
    assert abs(means.mean() - 1.0) < 4.0 * means.std(ddof=1) / np.sqrt(len(means)) + 0.15  # a pilot's bias
