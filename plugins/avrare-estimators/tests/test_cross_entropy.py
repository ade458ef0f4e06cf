"""Cross-entropy: its network, its stages, its budget, and what it says when it has not arrived."""

import importlib.util
from dataclasses import replace

import numpy as np
import pytest

import avrare
import toy_closed_loop as toy
from avrare.estimation.result import intervals
from avrare_estimators.ce.tilted_perception import INPUTS, OUTPUTS, Tilt, TiltNetwork, network_inputs

QUICK = {"epochs": 20, "rate": 5e-3, "hidden": 10, "rollouts": 150}
LIMIT = 6.0


def estimate(limit=LIMIT, **options):
    return avrare.estimate(toy.final_only(limit), "ce", **{**QUICK, **options})


def test_levels_rise_and_the_estimate_uses_a_sample_that_no_stage_has_seen():
    result = estimate(check=0.0)
    stages = result.diagnostics["stages"][0]
    levels = [stage["level"] for stage in stages if not stage["reached"]]
    assert levels == sorted(levels)
    assert stages[-1]["settled"]
    assert result.rollouts == 150 * (len(stages) + 1)
    assert result.diagnostics["rows"] == [150]


def test_not_reaching_failure_gives_a_warning():
    result = estimate(30.0, stages=2)
    assert len(result.diagnostics["stages"][0]) == 2
    assert "unchecked" in result.health
    assert result.interval[0] <= 1e-9 < 0.01 < result.interval[1]


def test_target_rows_of_every_stage_count():
    result = estimate(stages=2, check=0.0)
    target = 150 + 30 + 30  # the first stage, and the defensive rows of the second and of the final sample
    assert result.diagnostics["target_rows"] == [30]
    low, high = (intervals.clopper_pearson(failures, target, 0.95)[1] for failures in (0, 20))
    assert low <= result.blind_bound < high


def test_a_budget_covers_complete_stages_and_the_sample_takes_what_is_left():
    result = estimate(stages=4, budget="rollouts=2000", check=0.0)
    stages = len(result.diagnostics["stages"][0])
    assert result.diagnostics["rows"] == [400 * (5 - stages)]
    assert result.rollouts == 2000
    with pytest.raises(avrare.UsageError, match="does not pay"):
        estimate(stages=4, budget="rollouts=50")
    with pytest.raises(avrare.UsageError, match="clock"):
        estimate(budget="seconds=5")


def test_runs_are_a_prefix():
    few, many = (estimate(runs=runs, stages=2) for runs in (1, 2))
    np.testing.assert_array_equal(few.run_probabilities, many.run_probabilities[:1])


@pytest.mark.parametrize("wrong", [{"elite": 0.0}, {"hidden": 0}, {"elit": 0.1}])
def test_misuse(wrong):
    with pytest.raises(avrare.UsageError):
        estimate(**wrong)


LEARNING = {"epochs": 60, "rate": 5e-3, "hidden": 20, "rollouts": 400}


def network(scale=0.1, seed=0):
    rng = np.random.default_rng(seed)
    shapes = [(INPUTS, 100), (100,), (100, 100), (100,), (100, OUTPUTS), (OUTPUTS,)]
    layers = tuple(scale * rng.standard_normal(s) for s in shapes)
    return Tilt(TiltNetwork(np.zeros(INPUTS), np.ones(INPUTS), layers))


def world(n):
    here = toy.Line(toy.scene()).reset(np.zeros((n, 1)))
    x = here.others.x + np.random.default_rng(1).normal(0, 5, (n, 1))
    return replace(here, others=replace(here.others, x=x))


def test_a_network_of_zeros_is_the_target():
    target, many = toy.Pem(toy.scene()), world(30)
    tilted = network(0.0).for_target(target)
    noise = np.random.default_rng(2).standard_normal((30, 3))
    seen = target.observe(many, noise)
    np.testing.assert_array_equal(tilted.observe(many, noise).x, seen.x)
    np.testing.assert_allclose(tilted.log_prob(many, seen), target.log_prob(many, seen), rtol=1e-12)


def test_inputs_are_what_the_ego_sees():
    seen = network_inputs(world(4), toy.scene())
    assert seen.shape == (4, 1, INPUTS)
    np.testing.assert_allclose(seen[..., 2], np.hypot(seen[..., 0], seen[..., 1]))
    np.testing.assert_allclose(seen[..., 6:], [[[4.5, 1.8]]] * 4)


def test_tilted_density_integrates_to_one():
    """Check the mean weight of the target against a tilt of it, whatever the tilt."""
    proposal, options = network(0.06).for_target(toy.Pem(toy.scene())), {"defensive": 0.0, "check": 0.0}
    result = avrare.estimate(toy.final_only(4.0), "is", proposal=proposal, rollouts=6000, **options)
    marks = result.diagnostics
    assert 0.001 < marks["mean_weight_error"] < 0.1
    assert abs(marks["mean_weight"] - 1) < 4 * marks["mean_weight_error"]


@pytest.mark.slow
def test_it_learns_and_stays_unbiased():
    truth = toy.exact(7.0)
    result = avrare.estimate(toy.final_only(7.0), "ce", runs=10, check=0.0, **LEARNING)
    values = result.run_probabilities
    assert abs(values.mean() - truth) < 4 * values.std(ddof=1) / np.sqrt(10)
    assert result.relative_error < 0.3
    for stages in result.diagnostics["stages"]:
        assert stages[0]["failures"] < 5 < 40 < stages[-1]["failures"]


def test_a_target_without_law_is_refused():
    with pytest.raises(avrare.UsageError, match="no law"):
        avrare.estimate(toy.final_only(7.0, perception=toy.Blind(toy.scene())), "ce")


@pytest.mark.slow
def test_without_torch_there_is_a_pip_command(monkeypatch):
    find = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name, *rest: None if name == "torch" else find(name, *rest)
    )
    with pytest.raises(avrare.PluginError) as caught:
        avrare.estimate(toy.final_only(7.0), "ce")
    assert "avrare-estimators[torch]" in caught.value.hint
