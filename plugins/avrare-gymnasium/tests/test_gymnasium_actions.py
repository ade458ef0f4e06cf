"""Actions of environments, made from those of controllers."""

import numpy as np
import pytest
from gymnasium import spaces
from scipy import stats

from avrare.base.errors import UsageError
from avrare_gymnasium.actions import actions
from avrare_gymnasium.config import ActionNoiseConfig, FeedbackConfig
from avrare_gymnasium.controllers import build_feedback

TWO, FOUR = spaces.Discrete(2), spaces.Discrete(4, start=1)
BOX = spaces.Box(np.array([-1.0, -2.0], dtype=np.float32), np.array([1.0, 2.0], dtype=np.float32))
NONE = np.zeros((3, 0))


def noise(**options):
    return ActionNoiseConfig(**options)


def test_two_actions_from_one_number_or_an_index():
    found = actions(TWO, None)
    np.testing.assert_array_equal(found(np.array([[-0.1], [0.0], [0.1]]), NONE), [0, 0, 1])
    np.testing.assert_array_equal(found(np.array([1, 0, 1]), NONE), [1, 0, 1])
    pushed = actions(TWO, noise(scale=0.5))
    commands, numbers = np.array([[-0.1], [0.0], [0.1]]), np.array([[1.0], [-1.0], [-1.0]])
    np.testing.assert_array_equal(pushed(commands, numbers), [1, 0, 0])


def test_the_greatest_score_wins():
    scores = np.array([[0, 3, 1, 2], [9, 3, 1, 2], [0, 0, 0, 0.1]])
    np.testing.assert_array_equal(actions(FOUR, None)(scores, NONE), [2, 1, 4])
    moved = actions(FOUR, noise(scale=(0.0, 0.0, 10.0, 0.0)))
    numbers = np.array([[0, 0, 1.0, 0]] * 3)
    np.testing.assert_array_equal(moved(scores, numbers), [3, 3, 3])


def test_a_random_action_replaces_the_command():
    found = actions(FOUR, noise(law="random", probability=0.25))
    numbers = np.random.default_rng(0).normal(size=(8000, 2))
    chosen = found(np.full(8000, 2), numbers)
    counts = np.bincount(chosen, minlength=5)[1:]
    assert stats.chisquare(counts, 8000 * np.array([1, 13, 1, 1]) / 16).pvalue > 1e-3
    always = actions(FOUR, noise(law="random", probability=1.0))
    assert set(always(None, numbers)) == {1, 2, 3, 4}


def test_commands_are_clipped_to_the_box():
    commands = np.array([[0.5, -1.0], [3.0, -3.0], [0.0, 0.0]])
    found = actions(BOX, None)(commands, NONE)
    assert found.dtype == np.float32
    np.testing.assert_array_equal(found, np.array([[0.5, -1.0], [1.0, -2.0], [0.0, 0.0]], dtype=np.float32))
    moved = actions(BOX, noise(law="uniform", scale=0.25))(commands, np.array([[0.0, 40.0]] * 3))
    np.testing.assert_allclose(moved, [[0.5, -0.75], [1.0, -2.0], [0.0, 0.25]])
    anywhere = actions(BOX, noise(law="random", probability=1.0))(None, np.full((3, 3), 0.5))
    share = 2 * stats.norm.cdf(0.5) - 1
    np.testing.assert_allclose(anywhere, [[share, 2.0 * share]] * 3, rtol=1e-6)


@pytest.mark.parametrize(
    ("space", "options", "commands", "message"),
    [
        (TWO, None, None, "needs a controller"),
        (BOX, None, None, "needs a controller"),
        (TWO, {"law": "random", "probability": 0.5}, None, "needs a controller"),
        (TWO, None, np.zeros((3, 2)), "the command has 2 numbers, but 2 actions need 1"),
        (BOX, None, np.zeros((3, 1)), "the size 2, the controller's command 1"),
        (FOUR, None, np.array([1, 2, 0]), "are outside 1..4"),
        (TWO, {"scale": 1.0}, np.array([1, 0, 1]), "does not apply to integer actions"),
    ],
)
def test_arguments_that_do_not_fit_are_refused(space, options, commands, message):
    built = actions(space, noise(**options) if options else None)
    with pytest.raises(UsageError, match=message):
        built(commands, np.zeros((3, built.noise_size)))


def test_other_spaces():
    with pytest.raises(UsageError, match="MultiBinary"):
        actions(spaces.MultiBinary(3), None)
    with pytest.raises(UsageError, match="bounded"):
        actions(spaces.Box(-np.inf, np.inf, (1,)), noise(law="random", probability=1.0))


def test_feedback():
    config = FeedbackConfig(gain=((1, 2, 3), (0, 0, 1)), reference=(1, 1, 1), offset=(10, 0))
    seen = np.random.default_rng(1).normal(size=(7, 3))
    controller = build_feedback(config)
    found, _ = controller.act(controller.start(7), seen)
    expected = np.array([10.0, 0.0]) - (seen - 1.0) @ np.array([[1.0, 0.0], [2.0, 0.0], [3.0, 1.0]])
    np.testing.assert_allclose(found, expected)
    for row in range(7):
        np.testing.assert_array_equal(controller.act(None, seen[row : row + 1])[0][0], found[row])
    with pytest.raises(UsageError, match="3 columns, but the observation has 2"):
        controller.act(None, seen[:, :2])


@pytest.mark.parametrize(
    "options",
    [{"gain": ((1, 2), (1,))}, {"gain": ((1, 2),), "reference": (1,)}, {"gain": ((1, 2),), "offset": (1, 2)}],
)
def test_shapes_of_a_feedback(options):
    with pytest.raises(ValueError, match="gain"):
        FeedbackConfig(**options)


@pytest.mark.parametrize(
    "options", [{"law": "random"}, {"law": "random", "probability": 0.1, "scale": 1.0}, {}]
)
def test_noise_on_actions_is_added_or_random(options):
    with pytest.raises(ValueError, match="law random requires probability"):
        noise(**options)
