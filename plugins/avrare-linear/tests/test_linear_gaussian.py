"""The law of trajectories against recursions for mean and covariance, and against runs."""

import numpy as np
import pytest

import avrare
from avrare.testing.faulty_systems import Walk
from avrare.testing.problems import exponential_sum
from avrare_linear.gaussian import TrajectoryGaussian, simulate_signals
from avrare_linear.system import LinearSystem

RNG = np.random.default_rng(5)
STEPS = 12
A = np.array([[1.0, 0.1], [-0.05, 0.98]])
B, C = np.array([[0.005], [0.1]]), np.array([[1.0, 0.0]])
W, V, START = np.array([[0.01, 0.004], [0.004, 0.02]]), np.array([[0.09]]), np.diag([0.04, 0.01])
REFERENCE = RNG.standard_normal((STEPS + 1, 2))


def observed():
    names = {"inputs": ("a",), "outputs": ("seen",), "costs": (np.eye(2), np.eye(1)), "observer": True}
    arrays = {"covariance": START, "B": B, "C": C, "process_noise": W, "measurement_noise": V}
    return LinearSystem.of(("x", "v"), A, [0.5, 1.0], reference=REFERENCE, **names, **arrays)


class Squared(Walk):
    def signals(self, state):
        return {"x": state["x"], "energy": state["x"] ** 2}


class Paired(Walk):
    def signals(self, state):
        return {"x": np.stack([state["x"]] * 2, axis=1)}


def test_mean_and_covariance_are_those_of_the_recursion():
    linear = observed()
    K, L = linear.gain[0], linear.observer[0]
    loop = np.block([[A, -B @ K], [L @ C, A - B @ K - L @ C]])
    noise = np.block([[W, np.zeros((2, 2))], [np.zeros((2, 2)), L @ V @ L.T]])
    mean = np.tile([0.5, 1.0], 2)
    spread = np.block([[START, np.zeros((2, 2))], [np.zeros((2, 2)), np.zeros((2, 2))]])
    law = TrajectoryGaussian.of(linear, STEPS, ("x", "v", "x_estimate", "v_estimate"))
    for t in range(STEPS + 1):
        np.testing.assert_allclose(law.mean[t], mean, atol=1e-12)
        np.testing.assert_allclose(law.covariance[t, :, t], spread, atol=1e-12)
        if t < STEPS:
            np.testing.assert_allclose(law.covariance[t + 1, :, t], loop @ spread, atol=1e-12)
        mean = loop @ mean + np.tile((B @ K @ REFERENCE[t]).ravel(), 2)
        spread = loop @ spread @ loop.T + noise


def test_the_map_gives_the_signals_of_runs():
    linear = observed()
    tape = RNG.standard_normal((20, STEPS + 1, linear.noise_size))
    law = TrajectoryGaussian.of(linear, STEPS)
    found, expected = law.signals(tape), simulate_signals(linear, tape)
    assert set(found) == {"x", "v", "x_estimate", "v_estimate", "a", "seen"}
    for name, values in expected.items():
        np.testing.assert_allclose(found[name], values, atol=1e-12)
    some = law.select(("seen", "x"))
    np.testing.assert_array_equal(some.signals(tape)["x"], found["x"])


def test_the_covariance_is_that_of_many_runs():
    linear = observed()
    tape = RNG.standard_normal((40_000, STEPS + 1, linear.noise_size))
    law = TrajectoryGaussian.of(linear, STEPS, ("x", "a"))
    found = simulate_signals(linear, tape, law.names)
    drawn = np.cov(np.stack([found["x"][:, -1], found["a"][:, -1], found["x"][:, 3]]))
    chosen = ((-1, 0), (-1, 1), (3, 0))
    exact = [[law.covariance[*row, *column] for column in chosen] for row in chosen]
    size = np.sqrt(np.outer(np.diag(exact), np.diag(exact)))
    assert (np.abs(drawn - exact) < 4.5 * np.sqrt(2 / 40_000) * size).all()


def test_terms_that_are_not_affine_are_refused_by_name():
    with pytest.raises(avrare.UsageError, match="'energy' is not affine"):
        TrajectoryGaussian.of(Squared(), 5)
    with pytest.raises(avrare.UsageError, match="'total' is not affine"):
        TrajectoryGaussian.of(exponential_sum(30.0).system, 0)
    assert TrajectoryGaussian.of(Squared(), 5, ("x",)).names == ("x",)


class Bent(Walk):
    """A bend of size 1 on top of a large offset."""

    def signals(self, state):
        return {"x": 5e9 + np.tanh(state["x"])}


class Offset(Walk):
    def signals(self, state):
        return {"x": 5e9 + state["x"]}


def test_a_large_mean_does_not_hide_nonlinearity():
    with pytest.raises(avrare.UsageError, match="'x' is not affine"):
        TrajectoryGaussian.of(Bent(), 3)
    assert TrajectoryGaussian.of(Offset(), 50).steps == 50


def test_signals_of_vehicles_and_unknown_ones_are_refused():
    with pytest.raises(avrare.UsageError, match="'x' has more than one value"):
        TrajectoryGaussian.of(Paired(), 5)
    with pytest.raises(avrare.UsageError, match="the system has no signal 'y'"):
        TrajectoryGaussian.of(Walk(), 5, ("y",))
    with pytest.raises(avrare.UsageError, match="unknown signal 'y'"):
        TrajectoryGaussian.of(Walk(), 5).select(("y",))
