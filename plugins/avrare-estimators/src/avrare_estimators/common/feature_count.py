"""Number of features of a state, from the state at the start."""

from __future__ import annotations

import numpy as np

from avrare.rollout.problem import Problem
from avrare.stack.features import system_features

FEATURES = 32
"""Number of features where it is not known before the first rollout."""


def count_features(problem: Problem) -> int | None:
    """Return the number of features of a state; None where the system raises an error."""
    try:
        state = problem.system.initial(np.zeros((1, problem.noise_size)))
        return int(system_features(problem.system, state).shape[1]) + 3
    except Exception:  # the first rollout reports it
        return None
