"""Levels of a rule whose probability its truth knows."""

from __future__ import annotations

import numpy as np
import pytest

from avrare import Problem
from avrare.testing.problems import reference_problem
from benchmarks.studies.levels import ROOT, Level, read_case


def test_a_level_is_violated_where_robustness_falls_to_it():
    rule = reference_problem("d_rw_L2.5").problem()
    tapes = np.random.default_rng(0).standard_normal((300, rule.steps + 1, rule.noise_size))
    known = rule.replay(tapes).robustness[:, 0]
    level = float(np.quantile(known, 0.1, method="lower"))
    shifted = Problem(rule.system, Level(rule.monitors[0], level), rule.steps).replay(tapes)
    np.testing.assert_array_equal(shifted.violated[:, 0], known <= level)
    np.testing.assert_allclose(shifted.robustness[:, 0], known - level)
    assert 0 < shifted.violated.sum() < 60


def test_a_case_is_a_name_or_a_path_and_has_a_truth_or_a_number():
    _, known = read_case("glider_actuator:perches")
    assert known == pytest.approx(7.86e-4)
    path = str(ROOT / "scenarios" / "glider_actuator.yaml")
    _, level = read_case(f"{path}:perches@1e-4")
    assert level == pytest.approx(1e-4)
    _, given = read_case("glider_actuator:perches=0.5")
    assert given == 0.5
