"""Drives that end before the others: what follows counts for nothing."""

import numpy as np
import pytest

import avrare


class Climb:
    """x = 0, 1, 2, ...; a rollout whose first number is positive ends at x = 3."""

    noise_size = 1

    def initial(self, noise):
        return {"x": np.zeros(len(noise)), "ends": noise[:, 0] > 0.0}

    def step(self, state, noise):
        return {**state, "x": state["x"] + 1.0}

    def signals(self, state):
        return {"x": state["x"]}

    def ended(self, state):
        return state["ends"] & (state["x"] >= 3.0)


@pytest.mark.parametrize(
    "formula",
    [
        "always (x < 5)",
        "always (x < 5 or once[0, 3 samples] (x > 100))",
        "always ((x < 5) since (x < 1))",
        "always (x < 5 or always[2, 4 samples] (x > 100))",
    ],
)
def test_samples_after_the_end_count_for_nothing(formula):
    problem = avrare.Problem(Climb(), avrare.stl(formula), steps=8)
    noise = np.zeros((6, 9, 1))
    noise[::2, 0] = 1.0
    rollouts = problem.replay(noise)
    assert rollouts.violated[:, 0].tolist() == [False, True] * 3
    assert not rollouts.error.any()
