"""Gradients against finite differences of exact probabilities, and descent on the four squares of stl-ess."""

from dataclasses import replace
from statistics import NormalDist

import numpy as np
import pytest

import avrare
from avrare_linear.gaussian import TrajectoryGaussian
from avrare_linear.gradient import (
    apply_chain_rule,
    compute_sensitivity,
    estimate_log_gradient,
    estimate_log_hessian,
)
from avrare_linear.synthesis import DescentStep, Effort, descend, estimate_parameter_gradient, sample_failures
from avrare_linear.system import LinearSystem

Phi, quantile = NormalDist().cdf, NormalDist().inv_cdf
RNG = np.random.default_rng(8)
FOUR = "not ((x > 3 and y > 3) or (-x > 3 and y > 3) or (x > 3 and -y > 3) or (-x > 3 and -y > 3))"
T, LIMIT = 8, 3.5
REFERENCE = np.cumsum(0.2 * RNG.standard_normal((T + 1, 2)), axis=0)


def plane(mean, spread=(1.0, 1.0)):
    return LinearSystem.of(("x", "y"), np.eye(2), mean, covariance=np.diag(np.square(spread)))


def four_squares(mean, spread=(1.0, 1.0)):
    """Return the exact probability to lie in one of the squares."""
    tails = [Phi((m - 3.0) / s) + Phi((-m - 3.0) / s) for m, s in zip(mean, spread, strict=True)]
    return tails[0] * tails[1]


def observed():
    noise = {"process_noise": np.diag([0.02, 0.05]), "measurement_noise": [[0.1]]}
    names = {"inputs": ("a",), "outputs": ("seen",), "covariance": 0.1 * np.eye(2), **noise}
    options = {"gain": [[0.8, 1.1]], "observer": True, "reference": REFERENCE, "feedforward": [0.1]}
    step, push, seen = [[1, 0.3], [0, 0.9]], [[0.05], [0.3]], [[1, 0]]
    return LinearSystem.of(("x", "v"), step, [0, 0.3], B=push, C=seen, **names, **options)


def changed(system, parameter):
    """Return the entries of a parameter, and a function to systems with other ones."""
    value = getattr(system, parameter)
    return value, lambda entries: replace(system, **{parameter: entries.reshape(value.shape)})


def reaches_limit(system):
    """Return the exact probability that x is above the limit at the end."""
    law = TrajectoryGaussian.of(system, T, ("x",))
    return Phi((law.mean[T, 0] - LIMIT) / np.sqrt(law.covariance[T, 0, T, 0]))


def exact_failures(law, many):
    """Draw tapes with x above the limit at the end: a truncated normal along the last row of the map."""
    row = law.map[T, 0]
    size = np.linalg.norm(row)
    least = Phi((law.mean[T, 0] - LIMIT) / size)
    along = np.array([-quantile(u * least) for u in RNG.uniform(size=many)])
    tape = RNG.standard_normal((many, len(row)))
    tape += np.outer(along - tape @ row / size, row / size)
    return tape.reshape(many, T + 1, -1)


def by_differences(build, value):
    """Return the gradient of the logarithm of an exact probability."""
    step, found = 1e-5, np.empty(value.size)
    for k in range(value.size):
        ends = []
        for side in (1.0, -1.0):
            moved = value.ravel().copy()
            moved[k] += side * step
            ends.append(np.log(build(moved.reshape(value.shape))))
        found[k] = (ends[0] - ends[1]) / (2.0 * step)
    return found


PARAMETERS = ("mean", "spread", "process", "measurement", "reference", "feedforward", "gain", "observer")


@pytest.mark.parametrize("parameter", PARAMETERS)
def test_gradients_of_exact_failures(parameter):
    system = observed()
    value, build = changed(system, parameter)
    expected = by_differences(lambda entries: reaches_limit(build(entries)), value)
    law = TrajectoryGaussian.of(system, T, ("x",))
    tapes = exact_failures(law, 100_000)
    moves = compute_sensitivity(build, value.ravel(), T, ("x",))
    parts = [apply_chain_rule(law, estimate_log_gradient(law, part), moves) for part in np.split(tapes, 50)]
    error = np.std(parts, axis=0, ddof=1) / np.sqrt(50)
    found = np.mean(parts, axis=0)
    assert np.abs(expected).max() > 0.05
    assert (np.abs(found - expected) < 4.5 * error + 1e-6).all()
    assert error.max() < 0.1 * np.abs(expected).max()


@pytest.mark.parametrize("parameter", ["gain", "observer", "process"])
def test_the_complex_step_is_the_derivative_of_the_map(parameter):
    value, build = changed(observed(), parameter)
    found = compute_sensitivity(build, value.ravel(), T, ("x", "a"))
    for k in range(value.size):
        systems = (build(value.ravel() + side * 1e-5 * np.eye(value.size)[k]) for side in (1, -1))
        ahead, behind = (TrajectoryGaussian.from_affine(system, T, ("x", "a")) for system in systems)
        np.testing.assert_allclose(found.mean[k], (ahead.mean - behind.mean) / 2e-5, atol=1e-7)
        np.testing.assert_allclose(found.map[k], (ahead.map - behind.map) / 2e-5, atol=1e-7)


@pytest.mark.parametrize("parameter", ["mean", "spread"])
def test_the_gradient_of_sampled_failures(parameter):
    system, formula = plane([1.0, 0.5]), avrare.stl(FOUR)
    step = estimate_parameter_gradient(system, formula, 0, parameter, Effort(runs=8), seed=2)

    def exact(value):
        diagonal = np.diag(value[0]) if parameter == "spread" else (1.0, 1.0)
        return four_squares(value[0] if parameter == "mean" else (1.0, 0.5), diagonal)

    expected = by_differences(exact, step.parameter).reshape(step.parameter.shape)
    if parameter == "spread":  # the closed form has nothing to say of the entries beside the diagonal
        expected, found = np.diag(expected[0]), np.diag(step.gradient[0])
    else:
        found = step.gradient
    np.testing.assert_allclose(found, expected, rtol=0.1)
    assert step.probability == pytest.approx(four_squares((1.0, 0.5)), rel=0.5)


def test_failing_tapes_fail_and_have_the_right_law():
    problem = avrare.Problem(plane([0.0, 0.0]), avrare.stl("x < 2.5"), 0)
    failing = sample_failures(problem, Effort(chains=50, runs=4, moves=30), seed=3)
    tapes, weight = failing.tape, failing.weight
    assert failing.probability == pytest.approx(Phi(-2.5), rel=0.4)
    assert len(tapes) > 1000
    assert (problem.robustness(tapes) <= 1e-12).all()
    mean = NormalDist().pdf(2.5) / Phi(-2.5)
    assert weight.sum() == pytest.approx(1.0)
    assert weight @ tapes[:, 0, 0] == pytest.approx(mean, abs=0.03)
    assert weight @ tapes[:, 0, 1] ** 2 == pytest.approx(1.0, abs=0.1)


def test_a_parameter_that_moves_a_direction_without_noise_is_refused():
    system, formula = replace(observed(), spread=np.zeros((1, 2, 2))), avrare.stl("always (x < 2)")
    with pytest.raises(avrare.UsageError, match="direction without noise"):
        estimate_parameter_gradient(system, formula, T, "mean", Effort(chains=20, runs=1, moves=1))


def test_descent_stops_at_its_target():
    def bowl(value, iteration):
        return DescentStep(value, float(value[0] ** 2), 2.0 * value)

    start = np.array([1.0])
    every = descend(bowl, start, rate=0.25, iterations=6)
    assert [step.parameter[0] for step in every] == [0.5**k for k in range(6)]
    assert len(descend(bowl, start, rate=0.25, iterations=50, target=0.01)) == 5
    assert len(descend(bowl, start, rate=0.25, iterations=50, tolerance=0.1)) == 4
    with pytest.raises(avrare.UsageError, match="positive, finite rate"):
        descend(bowl, start, rate=0.0, iterations=5)


def hessian_of(system, parameter, many):
    """Return the estimate, its entries' standard errors, and a function to systems with other values."""
    law = TrajectoryGaussian.of(system, T, ("x",))
    value, build = changed(system, parameter)
    derivatives = compute_sensitivity(build, value.ravel(), T, ("x",))
    moves = derivatives.mean.reshape(value.size, -1) @ np.linalg.pinv(law.map[:, 0]).T
    size = moves @ moves.T
    error = np.sqrt((np.outer(np.diag(size), np.diag(size)) + size**2) / many)
    return estimate_log_hessian(law, exact_failures(law, many), derivatives), error, build


@pytest.mark.parametrize(
    ("system", "parameter"), [(plane((1.0, 1.0)), "mean"), (observed(), "mean"), (observed(), "feedforward")]
)
def test_the_hessian_is_that_of_finite_differences(system, parameter):
    found, error, build = hessian_of(system, parameter, 60_000)
    start, step, unit = getattr(system, parameter).ravel(), 1e-3, np.eye(len(found))

    def log_p(*moves):
        return np.log(reaches_limit(build(start + step * sum(moves))))

    exact = [[log_p(a, b) - log_p(a, -b) - log_p(-a, b) + log_p(-a, -b) for b in unit] for a in unit]
    exact = np.array(exact) / (4.0 * step**2)
    assert (np.abs(found - exact) <= 4.0 * error + 1e-4).all(), (found, exact, error)
    if len(unit) == 2 and system.gain.size == 0:
        assert error[0, 0] < 0.06 * abs(exact[0, 0]), "sharp enough to tell the centred moment"
        assert found[1, 1] == 0.0, "y decides nothing"


def test_the_hessian_of_a_gain_is_refused():
    with pytest.raises(avrare.UsageError, match="move the mean alone"):
        hessian_of(observed(), "gain", 10)
