"""Scaled laws, and the density ratios of nearby models."""

import numpy as np
import pytest

import avrare
from avrare.analysis.causes.tape_runs import draw_tapes
from avrare.rollout.observation_ratios import log_ratios

SCENARIO = "scenarios/lane_change.yaml"
MODELS = {
    "parametric": ["perception.plugin=parametric"],
    "persistent": [
        "perception.plugin=parametric",
        "perception.persistence={detection: 0.5, position: 0.4, detection_lasting: 0.2}",
    ],
    "measured": [],
}


def load(model, *more):
    return avrare.load(SCENARIO, ["steps=12", *MODELS[model], *more])


def perception(model, name, value):
    return load(model, f"perception.{name}={value}").stack.loop.perception


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("name", ["miss_scale", "error_scale", "tail_scale"])
def test_the_mean_of_the_ratio_is_one(model, name):
    problem = load(model).problem("no_collision")
    tapes = draw_tapes(problem, 5, 0, 150)
    others = [perception(model, name, value) for value in (1.03, 1.001, 0.999)]
    ratios = log_ratios(problem, others, tapes)
    weights, scores = np.exp(ratios[:, 0]), (ratios[:, 1] - ratios[:, 2]) / 0.002
    assert abs(weights.mean() - 1.0) < 4.0 * weights.std() / 150**0.5
    assert abs(scores.mean()) < 4.0 * scores.std() / 150**0.5
    assert scores.std() > 0.3


def test_the_ratio_of_independent_errors_is_that_of_the_densities():
    problem = load("parametric").problem("no_collision")
    tapes = draw_tapes(problem, 5, 0, 20)
    own, other = problem.system.perception, perception("parametric", "error_scale", 1.2)
    state = problem.system.step(problem.system.initial(tapes[:, 0]), tapes[:, 1])
    found, _ = own.log_ratio(state.world, tapes[:, 1], None, other, None)
    expected = other.log_prob(state.world, state.observation) - own.log_prob(state.world, state.observation)
    np.testing.assert_allclose(found, expected, atol=1e-6)


@pytest.mark.parametrize(
    ("name", "field"), [("miss_scale", "miss"), ("error_scale", "scale"), ("tail_scale", "power")]
)
def test_a_scale_of_one_changes_no_bit_and_two_changes_its_part(name, field):
    world = load("measured").stack.loop.initial(np.zeros((3, 12))).world
    laws = [perception("measured", name, value).memoryless.law(world) for value in (1.0, 1.0, 2.0)]
    assert (getattr(laws[0], field) == getattr(laws[1], field)).all()
    assert (getattr(laws[2], field) > getattr(laws[0], field)).all()
    assert laws[2].detect + laws[2].miss == pytest.approx(1.0)


def test_the_noise_of_a_perfect_detector_sees_every_vehicle():
    loop = load("measured").stack.loop
    noise = np.broadcast_to(loop.perfect_noise, (2, 12))
    state = loop.initial(noise)
    for _ in range(3):
        state = loop.step(state, noise)
    assert state.observation.detected[:, :2].all()
