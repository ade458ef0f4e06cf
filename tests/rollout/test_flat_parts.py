"""Parts of a formula that show nothing before they fail are found, and told beside an estimate."""

import numpy as np
import pytest

import avrare
from avrare.estimation.result.doubts import undo_opening

STEPS = 5


class Walks:
    """Two walks; ``flat`` shows nothing of the second before it ends above 4.5 standard deviations."""

    noise_size = 2

    def initial(self, noise):
        return np.zeros((len(noise), 2))

    def step(self, state, noise):
        return state + noise / STEPS**0.5

    def signals(self, state):
        x, y = state.T
        return {"x": x / 4.0, "y": y, "flat": np.where(y >= 4.5, 1.1, 0.0), "alarm": y >= 4.5}


def flat_parts(text, score=None):
    return avrare.Problem(Walks(), avrare.stl(text), STEPS, score).flat_parts(0)


@pytest.mark.parametrize(
    "text",
    [
        "always (x < 1 and flat < 1)", "not eventually (x >= 1 or flat > 1)",
        "(always x < 1) and always (flat < 1)", "always (x < 1 and not (alarm > 0))",
    ],
)  # fmt: skip
def test_a_part_that_shows_nothing_is_found(text):
    (part,) = flat_parts(text)
    assert "flat" in part or "alarm" in part
    assert "x" not in part


@pytest.mark.parametrize(
    "text",
    ["always (x < 1 and y < 3)", "always (x < 1 or y < 3)", "eventually y > -3", "always (x < 1 and 0 < 1)"],
)
def test_parts_that_move_are_not_flat(text):
    assert flat_parts(text) == ()


def test_a_score_of_the_margin_compares_samples():
    # Most rollouts are nearest to the bound at the start, which tells nothing.
    class FromAbove(Walks):
        def initial(self, noise):
            return np.tile([-4.0, 0.0], (len(noise), 1))

        def step(self, state, noise):
            return 0.5 * state + 0.1 * noise

    flat = [
        avrare.Problem(FromAbove(), avrare.stl("always (x > -1.1)"), STEPS, score).flat_parts(0)
        for score in ("margin", "robustness")
    ]
    assert flat == [(), ("always (x > -1.1)",)]


def test_a_function_that_scores_may_see_what_the_formula_does_not():
    assert flat_parts("always (x < 1 and flat < 1)", lambda signals, t: signals["y"][:, t]) == ()


def test_known_failures_show_that_a_flat_part_can_be_broken():
    problem = avrare.Problem(Walks(), avrare.stl("always (x < 1 and flat < 1)"), STEPS)
    tapes = np.zeros((2, STEPS + 1, 2))
    tapes[0, 1, 0] = 10.0
    (part,) = problem.flat_parts(0, tapes)
    assert part == problem.flat_parts(0)[0]
    tapes[1, 1, 1] = 11.0
    assert problem.flat_parts(0, tapes) == ()


@pytest.mark.parametrize("part", ["flat < 1", "y < 9"])
def test_an_estimate_far_below_its_blind_bound_tells_of_a_flat_part(part):
    problem = avrare.Problem(Walks(), avrare.stl(f"always (x < 1 and {part})"), STEPS)
    result = avrare.estimate(problem, "ess", seed=2, chains=30, runs=4)
    assert result.blind_bound > 3.0 * undo_opening(result).interval[1]
    assert ("flat_part" in result.health) == (part == "flat < 1")
