"""Intervals of recorded runs, as the estimators give them."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from avrare.estimation.result import intervals
from avrare.estimation.result.intervals import Interval
from avrare.protocols import Floats
from avrare_estimators.ams.summary import relative_variance


def interval_of_runs(values: Floats, particles: int) -> Callable[[float], Interval]:
    """Return the interval of runs that needed levels and met no errors, as a function of the confidence.

    Args:
        values: (runs,) probabilities of at least two runs.
        particles: Number of particles of each run.
    """
    if not values.any():
        return intervals.unknown
    mean, freedom = float(values.mean()), len(values) - 1
    relative = relative_variance(values, np.zeros(1), particles)
    return partial(intervals.log_normal, mean, relative, freedom=freedom, logs=intervals.cox(values))
