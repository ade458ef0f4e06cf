"""An estimate is checked by an estimator of another family, at a share of its cost."""

import json
from dataclasses import replace
from functools import partial
from types import MappingProxyType

import numpy as np
import pytest

import avrare
from avrare.base.errors import UsageError
from avrare.estimation.combine.cross_check import add_cross_check, compare
from avrare.estimation.loop.loop import run
from avrare.estimation.plan.plan import Settings
from avrare.estimation.result import intervals
from avrare.rollout.executors.serial import SerialExecutor
from avrare.scenario.cross_check import CrossCheck
from avrare.testing import faulty_systems as systems
from estimates import estimate_through_kills

SMALL = {"particles": 90, "discard": 20, "runs": 2}
WHOLE = {"share": 1.0}


def problem(lives=10**9, limit=1.5, steps=20):
    system = systems.Mortal(systems.Walk(), lives)
    return avrare.Problem(system, avrare.stl(f"always (x < {limit})"), steps=steps, chunk=50)


@pytest.fixture(scope="module")
def estimate():
    """Return a result to change: its own numbers do not matter."""
    return avrare.estimate(problem(), "mc", rollouts=200)


def splitting(result, probability, relative_error, runs=10):
    law = partial(intervals.log_normal, probability, relative_error**2, freedom=runs - 1)
    return replace(result, estimator="ams", probability=probability, interval_at=law, simulated_steps=200_000)


def counted(result, failures, trials):
    law = partial(intervals.clopper_pearson, failures, trials)
    return replace(result, probability=failures / trials, interval_at=law)


def execute(checked, estimator, settings):
    return run(checked, estimator, SerialExecutor(), settings)[0]


def plain(result):
    content = json.loads(result.to_json())
    del content["seconds"], content["cross_check"]["result"]["seconds"]
    return content


@pytest.mark.parametrize(
    ("ratio", "outcome", "noticed"),
    [(1.1, "agree", 2.56), (2.5, "agree", 2.56), (2.7, "disagree", 2.56), (0.3, "agree", 3.86),
     (0.2, "disagree", 3.86)],
)  # fmt: skip
def test_errors_of_both_decide(estimate, ratio, outcome, noticed):
    # sqrt(log(1 + .3^2)) = .294 for each; t(9) is 2.26 at 95 %, 3.25 at 99 %: exp(.94) and exp(1.35)
    found = compare(splitting(estimate, 1e-4, 0.3), splitting(estimate, ratio * 1e-4, 0.3))
    assert found == (outcome, pytest.approx(noticed, abs=0.01))


def test_a_check_without_failures_is_judged_by_its_exact_bound(estimate):
    bound = 1.0 - 0.005 ** (1 / 1000)  # 5.3e-3
    nothing = counted(estimate, 0, 1000)
    assert compare(splitting(estimate, 5e-2, 0.2), nothing)[0] == "disagree"
    assert compare(splitting(estimate, 2e-3, 0.2), nothing) == ("agree", pytest.approx(bound / 2e-3))
    assert compare(splitting(estimate, 1e-4, 0.2), nothing)[0] == "inconclusive"
    assert compare(nothing, splitting(estimate, 5e-2, 0.2))[0] == "disagree"


def test_two_that_found_nothing_do_not_agree(estimate):
    assert compare(counted(estimate, 0, 1000), counted(estimate, 0, 1000))[0] == "inconclusive"


def test_a_check_that_would_not_notice_a_factor_of_ten_says_nothing(estimate):
    vague = splitting(estimate, 1e-4, 2.0, runs=3)
    assert compare(splitting(estimate, 1e-4, 0.3), vague)[0] == "inconclusive"


@pytest.mark.parametrize("suppress", [(), ("contradicted",)])
def test_disagreement_is_a_health_warning_with_both_numbers(estimate, suppress):
    wrong = splitting(estimate, 1e-6, 0.2)
    result = add_cross_check(problem(), wrong, CrossCheck(), Settings(1, suppress=suppress), execute)
    found = result.cross_check
    assert (found.estimator, found.outcome) == ("ess", "disagree")
    assert 1e-4 < found.result.probability < 4e-3  # about 8e-4
    assert ("contradicted" in result.health) == (not suppress)
    if not suppress:
        assert "ams gives 1.0e-06" in result.health["contradicted"]
        assert f"by ess gives {found.result.probability:.1e}" in result.health["contradicted"]


def test_the_cost_is_a_share_of_the_estimate_s(estimate):
    result = add_cross_check(problem(), splitting(estimate, 8e-4, 0.2), CrossCheck(), Settings(1), execute)
    assert 0.07 < result.cross_check.result.simulated_steps / result.simulated_steps < 0.2
    shared = replace(splitting(estimate, 8e-4, 0.2), shared_by=5)
    half = add_cross_check(problem(), shared, CrossCheck(share=0.5), Settings(1), execute)
    assert 0.4 < half.cross_check.result.simulated_steps / result.cross_check.result.simulated_steps < 1.0


def test_too_small_a_share_runs_nothing_and_says_so():
    result = avrare.estimate(problem(), "ams", cross_check=True, seed=1, **SMALL)
    found = result.cross_check
    assert (found.outcome, found.result) == ("inconclusive", None)
    assert "15 % of the cost pays for only" in {note.kind: note.text for note in result.notes}["cross_check"]
    assert "contradicted" not in result.health


@pytest.mark.parametrize(
    ("name", "options", "changes", "checker"),
    [
        ("ams", SMALL, {}, "ess"),
        ("ams", SMALL, {"limit": 0.8}, "mc"),
        ("ess", {"chains": 10, "runs": 1}, {}, "ams"),
        ("ess", {"chains": 20, "runs": 2}, {"steps": 0, "limit": -0.1}, "mc"),
        ("mc", {"rollouts": 300}, {"limit": 0.9}, "ams"),
        ("is", {"rollouts": 2000, "proposal": {"name": "gaussian", "mean": 0.3}}, {}, "ess"),
    ],
)
def test_another_family_checks(name, options, changes, checker):
    result = avrare.estimate(problem(**changes), name, seed=1, cross_check=WHOLE, **options)
    assert result.cross_check.estimator == checker
    assert result.cross_check.result.rollouts > 0


def test_one_of_the_same_family_is_refused():
    with pytest.raises(UsageError, match="ams is of the same family as ams"):
        avrare.estimate(problem(), "ams", cross_check={"estimator": "ams"})
    with pytest.raises(UsageError, match="ess is of the same family as ess_linear"):
        avrare.estimate(problem(), "ess_linear", cross_check={"estimator": "ess"})
    with pytest.raises(UsageError, match="unknown option 'shares'"):
        avrare.estimate(problem(), "ams", cross_check={"shares": 0.2})
    with pytest.raises(UsageError, match="cross_check must be"):
        avrare.estimate(problem(), "ams", cross_check="ess")


def test_only_an_estimator_that_checks_others_is_accepted():
    with pytest.raises(UsageError, match="estimator 'is' checks no others") as caught:
        avrare.estimate(problem(), "ams", cross_check={"estimator": "is"})
    assert caught.value.hint == "estimators that do: ams, ess, mc"
    with pytest.raises(UsageError, match="unknown estimator 'esss'") as caught:
        avrare.estimate(problem(), "ams", cross_check={"estimator": "esss"})
    assert caught.value.hint == "did you mean 'ess'?"


def test_a_system_that_cannot_branch_is_checked_by_what_needs_none():
    class Closed(systems.Walk):
        lacks = MappingProxyType({"branches": "its states are out of reach"})

    closed = avrare.Problem(Closed(), avrare.stl("always (x < 0.9)"), steps=20)
    result = avrare.estimate(closed, "mc", seed=1, rollouts=300, cross_check=WHOLE)
    assert result.cross_check.estimator == "ess"


def test_the_estimate_itself_is_not_changed():
    alone = json.loads(avrare.estimate(problem(), "ams", seed=2, **SMALL).to_json())
    checked = plain(avrare.estimate(problem(), "ams", seed=2, cross_check=WHOLE, **SMALL))
    checked["cross_check"] = None
    (note,) = (note for note in checked["notes"] if note["kind"] == "cross_check")
    checked["notes"].remove(note)
    del alone["seconds"]
    for content in (alone, checked):
        del content["health"], content["warnings"]
    assert checked == alone


def test_a_budget_pays_for_both():
    result = avrare.estimate(problem(limit=0.5), "mc", budget="steps=20000", cross_check=True)
    assert result.simulated_steps == 20 * int(1000 / 1.15)
    assert result.cross_check.result.rollouts > 0
    assert result.simulated_steps + result.cross_check.result.simulated_steps < 21_000


@pytest.mark.slow
def test_workers_change_nothing():
    arguments = {"seed": 3, "cross_check": WHOLE, **SMALL}
    one = avrare.estimate(problem(), "ams", **arguments)
    assert plain(avrare.estimate(problem(), "ams", workers=2, **arguments)) == plain(one)
    assert one.cross_check.result.rollouts > 0


@pytest.mark.slow
def test_killed_in_the_check_it_goes_on_there(tmp_path):
    arguments = {"seed": 4, "cross_check": WHOLE, **SMALL}
    whole = avrare.estimate(problem(), "ams", **arguments)
    folder, in_check = tmp_path / "kept", []

    def attempt(kills):
        in_check.append(any(folder.glob("*+check/*.npz")))
        return avrare.estimate(problem(300), "ams", checkpoint=folder, **arguments)

    result, _ = estimate_through_kills(attempt)
    assert sum(in_check) > 1
    assert plain(result) == plain(whole)
    assert not folder.exists()


def test_a_checkpoint_belongs_to_its_check(tmp_path):
    with pytest.raises(systems.Killed):
        avrare.estimate(problem(30), "ams", seed=4, checkpoint=tmp_path / "kept", cross_check=True, **SMALL)
    with pytest.raises(UsageError, match=r"cross_check"):
        avrare.estimate(problem(), "ams", seed=4, checkpoint=tmp_path / "kept", **SMALL)


def test_its_noise_is_its_own(estimate):
    seeds = []

    def spy(checked, estimator, settings):
        seeds.append(settings.seed)
        return result

    result = splitting(estimate, 1e-3, 0.2)
    for seed in (0, 1, 1):
        add_cross_check(problem(), result, CrossCheck(), Settings(seed), spy)
    assert len({*seeds, 0, 1}) == 4
    assert seeds[1] == seeds[2]
    assert np.min(seeds) >= 0
