"""Levels of a rule whose probability its truth knows."""

from __future__ import annotations

import numpy as np
import pytest

from avrare import Problem
from avrare.testing.problems import reference_problem
from benchmarks.studies.levels import Level, read_level


def test_a_level_is_violated_where_robustness_falls_to_it():
    rule = reference_problem("d_rw_L2.5").problem()
    tapes = np.random.default_rng(0).standard_normal((300, rule.steps + 1, rule.noise_size))
    known = rule.replay(tapes).robustness[:, 0]
    level = float(np.quantile(known, 0.1, method="lower"))
    shifted = Problem(rule.system, Level(rule.monitors[0], level), rule.steps).replay(tapes)
    np.testing.assert_array_equal(shifted.violated[:, 0], known <= level)
    np.testing.assert_allclose(shifted.robustness[:, 0], known - level)
    assert 0 < shifted.violated.sum() < 60


@pytest.mark.parametrize("wanted", [1e-3, 1e-4, 1e-5])
def test_a_level_of_the_lane_change_is_read_from_its_truth(wanted):
    problem, probability = read_level("lane_change", "no_collision", wanted)
    assert probability == pytest.approx(wanted, rel=0.01)
    assert isinstance(problem.monitors[0], Level)
    assert problem.monitors[0].level < 0
    _, own = read_level("lane_change", "no_collision", None)
    assert 1e-3 < own < 5e-3
