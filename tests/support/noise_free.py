"""Rollouts without noise, as the pictures of a scenario show them."""

import numpy as np

from avrare.rollout.replay import replay_tapes


def noise_free(problem):
    """Return signals of the rollout without noise."""
    (rollout,) = replay_tapes(problem, np.zeros((1, problem.steps + 1, problem.noise_size)))
    assert rollout.error is None
    return rollout.signals
