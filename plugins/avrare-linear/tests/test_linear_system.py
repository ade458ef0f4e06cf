"""The system against its own equations, written out with matrices, one particle at a time."""

import numpy as np
import pytest

import avrare
from avrare_linear.gains import kalman, regulator
from avrare_linear.system import LinearSystem

RNG = np.random.default_rng(3)
DT = 0.1
A = np.block([[np.eye(2), DT * np.eye(2)], [np.zeros((2, 2)), np.eye(2)]])
B = np.vstack([0.5 * DT**2 * np.eye(2), DT * np.eye(2)])
C = np.hstack([np.eye(2), np.zeros((2, 2))])
ROOT = RNG.standard_normal((4, 4)) / 10
W, V, START = ROOT @ ROOT.T, 0.01 * np.eye(2), 0.04 * np.eye(4)
REFERENCE = np.cumsum(RNG.standard_normal((12, 4)), axis=0)


def system(**changes):
    options = {"inputs": ("ax", "ay"), "outputs": ("sx", "sy"), "costs": (np.eye(4), np.eye(2))}
    options |= {"covariance": START, "B": B, "C": C, "process_noise": W, "measurement_noise": V}
    options |= {"observer": True, "reference": REFERENCE, "feedforward": RNG.standard_normal((12, 2))}
    names, step = ("x", "y", "vx", "vy"), changes.pop("A", A)
    return LinearSystem.of(names, step, [0, 0, 1, 0], **{**options, **changes})


def varying():
    return system(
        A=np.stack([A * (1 + 0.01 * t) for t in range(5)]),
        process_noise=np.stack([W, 4 * W]),
        C=np.stack([C, 2 * C, C]),
    )


SYSTEMS = {"constant": system, "varying": varying, "state feedback": lambda: system(observer=False)}


def drive(linear, tape):
    state = linear.initial(tape[:, 0])
    states = [state]
    for t in range(1, tape.shape[1]):
        state = linear.step(state, tape[:, t])
        states.append(state)
    return states


def by_hand(linear, tape):
    """Run one particle, with matrices; return its signals (T + 1, ...)."""

    def at(stack, t):
        return stack[min(t, len(stack) - 1)]

    n, seen = len(linear.names[0]), linear.observer is not None
    x = linear.mean[0] + linear.spread[0] @ tape[0, :n]
    z = linear.mean[0]
    rows = []
    for t in range(len(tape)):
        y = at(linear.C, t) @ x + at(linear.measurement, t) @ tape[t, n:]
        u = at(linear.feedforward, t) - at(linear.gain, t) @ ((z if seen else x) - at(linear.reference, t))
        rows.append(np.concatenate([x, z if seen else [], u, y]))
        if t + 1 < len(tape):
            x = at(linear.A, t) @ x + at(linear.B, t) @ u + at(linear.process, t) @ tape[t + 1, :n]
            if seen:
                surprise = at(linear.observer, t) @ (y - at(linear.C, t) @ z)
                z = at(linear.A, t) @ z + at(linear.B, t) @ u + surprise
    return np.stack(rows)


@pytest.mark.parametrize("name", SYSTEMS)
def test_the_equations(name):
    linear = SYSTEMS[name]()
    tape = RNG.standard_normal((5, 21, linear.noise_size))
    states = drive(linear, tape)
    found = np.stack([np.stack(list(linear.signals(state).values()), axis=1) for state in states], axis=1)
    for row in range(5):
        np.testing.assert_allclose(found[row], by_hand(linear, tape[row]), rtol=1e-11, atol=1e-11)


def test_the_regulator_is_the_cheapest_gain():
    Q, R = np.diag([3.0, 3.0, 1.0, 1.0]), 0.5 * np.eye(2)

    def cost(gain):
        x, total = np.array([1.0, -1.0, 0.3, 0.2]), 0.0
        for _ in range(600):
            u = -gain @ x
            total += x @ Q @ x + u @ R @ u
            x = A @ x + B @ u
        return total

    best = regulator(A[None], B[None], Q, R)[0]
    for _ in range(5):
        assert cost(best) < cost(best + 0.05 * RNG.standard_normal(best.shape))


def test_over_many_steps_the_gains_converge_to_the_stationary_ones():
    Q, R = np.eye(4), np.eye(2)
    many = np.stack([A] * 300)
    stationary = regulator(A[None], B[None], Q, R)
    np.testing.assert_allclose(regulator(many, B[None], Q, R)[0], stationary[0], rtol=1e-8)
    stationary = kalman(A[None], C[None], W[None], V[None], START)
    gains = kalman(many, C[None], W[None], V[None], START)
    assert gains.shape == (300, 4, 2)
    assert not np.allclose(gains[0], stationary[0], rtol=1e-3)
    np.testing.assert_allclose(gains[-1], stationary[0], rtol=1e-8)


def test_the_first_kalman_gain_is_that_of_the_start():
    gains = kalman(np.stack([A, A]), C[None], W[None], V[None], START)
    np.testing.assert_allclose(gains[0], A @ START @ C.T @ np.linalg.inv(C @ START @ C.T + V), rtol=1e-10)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"A": np.eye(3)}, "A must be 4 x 4"),
        ({"C": np.full((2, 4), np.nan)}, "C has entries that are not finite"),
        ({"process_noise": np.triu(np.ones((4, 4)))}, "process_noise must be symmetric"),
        ({"process_noise": -np.eye(4)}, "negative eigenvalue"),
        ({"measurement_noise": np.zeros((2, 2)), "process_noise": None, "C": 0 * C}, "no optimal gain"),
    ],
)
def test_wrong_options_are_refused(changes, message):
    with pytest.raises(avrare.UsageError, match=message):
        system(**changes)
