"""The network proposal: it starts as the target, learns what leads to failure, and its weights are right."""

import sys
from pathlib import Path

import numpy as np
import pytest

import avrare
from avrare_estimators.ce.tilted_perception import INPUTS, OUTPUTS, Tilt, TiltNetwork, network_inputs

sys.path.insert(0, str(Path(__file__).parent))
import toy_closed_loop as toy

LIMIT = 7.0
QUICK = {"epochs": 60, "rate": 5e-3, "hidden": 20, "rollouts": 400}


def network(scale=0.1, seed=0):
    rng = np.random.default_rng(seed)
    shapes = [(INPUTS, 100), (100,), (100, 100), (100,), (100, OUTPUTS), (OUTPUTS,)]
    layers = tuple(scale * rng.standard_normal(s) for s in shapes)
    return Tilt(TiltNetwork(np.zeros(INPUTS), np.ones(INPUTS), layers))


def world(n):
    here = toy.Line(toy.scene()).reset(np.zeros((n, 1)))
    x = here.others.x + np.random.default_rng(1).normal(0, 5, (n, 1))
    from dataclasses import replace

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
    task = toy.final_only(4.0)
    result = avrare.estimate(
        task,
        "is",
        proposal=network(0.06).for_target(toy.Pem(toy.scene())),
        rollouts=6000,
        defensive=0.0,
        check=0.0,
    )
    marks = result.diagnostics
    assert 0.001 < marks["mean_weight_error"] < 0.1
    assert abs(marks["mean_weight"] - 1) < 4 * marks["mean_weight_error"]


@pytest.mark.slow
def test_it_learns_and_stays_unbiased():
    truth = toy.exact(LIMIT)
    result = avrare.estimate(toy.final_only(LIMIT), "ce", runs=10, check=0.0, **QUICK)
    values = result.run_probabilities
    assert abs(values.mean() - truth) < 4 * values.std(ddof=1) / np.sqrt(10)
    assert result.relative_error < 0.3
    for stages in result.diagnostics["stages"]:
        assert stages[0]["failures"] < 5 < 40 < stages[-1]["failures"]


def test_a_target_without_law_is_refused():
    with pytest.raises(avrare.UsageError, match="no law"):
        avrare.estimate(toy.final_only(LIMIT, perception=toy.Blind(toy.scene())), "ce")


@pytest.mark.slow
def test_without_torch_there_is_a_pip_command(monkeypatch):
    import importlib.util

    find = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name, *rest: None if name == "torch" else find(name, *rest)
    )
    with pytest.raises(avrare.PluginError) as caught:
        avrare.estimate(toy.final_only(LIMIT), "ce")
    assert "avrare-estimators[torch]" in caught.value.hint
