"""Scaled laws, and the density ratios of nearby models."""

import numpy as np
import pytest

import avrare
from avrare.analysis.causes.tape_runs import draw_tapes
from avrare.rollout.weighted_problem import log_ratios
from avrare_gp_pem.runtime import normal

SCENARIO = "scenarios/lane_change_published.yaml"
LASTING = "perception.persistence={detection: 0.5, position: 0.4, detection_lasting: 0.2}"
MODELS = {
    "parametric": ["perception.plugin=parametric"],
    "persistent": ["perception.plugin=parametric", LASTING],
    "measured": ["perception.model=measured", "perception.persistence=measured"],
}


def load(model, *more):
    return avrare.load(SCENARIO, ["steps=12", "controller.backend=riccati", *MODELS[model], *more])


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


@pytest.mark.parametrize(
    "change", [("error_scale", 1.5), ("error_scale", 0.6), ("tail_scale", 0.6), ("miss_scale", 3.0)]
)
def test_the_moved_tape_makes_another_detector_observe_the_same(change):
    problem, other = load("persistent").problem("no_collision"), perception("persistent", *change)
    own, tapes = problem.system.perception, draw_tapes(problem, 6, 0, 40)
    state, moved = problem.system.initial(tapes[:, 0]), 0.0
    memory = other.start(tapes[:, 0, problem.system.world_noise :])
    for step in range(1, 6):
        before, state = state.latent, problem.system.step(state, tapes[:, step])
        _, memory = own.log_ratio(state.world, tapes[:, step], before, other, memory)
        latent = other.latent(memory)
        found, expected = other.memoryless.observe(state.world, latent), state.observation
        np.testing.assert_array_equal(found.detected, expected.detected)
        np.testing.assert_allclose(found.x, expected.x, atol=1e-6)
        np.testing.assert_allclose(found.y, expected.y, atol=1e-6)
        moved = max(moved, float(np.abs(latent - own.latent(state.latent)).max()))
    assert moved > 0.2


def test_quantiles_invert_the_distribution_function():
    z = np.linspace(-30.0, 5.0, 200)
    for start in (-30.0, -1.0, 5.0):
        found = normal.quantile(np.log(normal.cdf(z)), np.full_like(z, start))
        np.testing.assert_allclose(found, z, atol=1e-7)


def test_a_quantile_does_not_depend_on_its_neighbours():
    rng = np.random.default_rng(0)
    z = 3.0 * rng.standard_normal(300) - 1.0
    wanted = np.minimum(np.log(normal.cdf(z)) + 0.3 * rng.standard_normal(300), -1e-9)
    alone = [normal.quantile(wanted[k : k + 1], z[k : k + 1])[0] for k in range(300)]
    np.testing.assert_array_equal(normal.quantile(wanted, z), alone)


SURE = ["perception.detection_plateau=1.0", "perception.detection_range=500.0"]


@pytest.mark.parametrize("model", ["parametric", "persistent"])
@pytest.mark.parametrize(
    ("own", "other"),
    [
        (["perception.error_limit=5.0"], ["perception.error_limit=5.5"]),
        (["perception.speed_sd=0.0"], ["perception.speed_sd=0.1"]),
        ([*SURE, "perception.detection_width=1.0"], [*SURE, "perception.detection_width=30.0"]),
    ],
)
def test_there_is_no_ratio_where_another_law_observes_more(model, own, other):
    problems = [load(model, *options).problem("no_collision") for options in (own, other)]
    tapes = draw_tapes(problems[0], 5, 0, 20)
    assert np.isnan(log_ratios(problems[0], [problems[1].system.perception], tapes)).all()
    # What the other law cannot observe has weight 0, which loses nothing; exact speeds are never the others.
    back = log_ratios(problems[1], [problems[0].system.perception], tapes)
    assert np.isnan(back).all() if "speed" in own[0] else not np.isnan(back).any()
