"""The conformance suite for ess, with its default kernel and with the one that needs no tuning."""

from typing import ClassVar

import pytest

from avrare.testing.estimators import EstimatorConformance
from avrare.testing.problems import count_down, walk
from avrare.testing.repeated_estimates import Study


@pytest.mark.slow
class TestEss(EstimatorConformance):
    estimator = "ess"
    options: ClassVar = {"chains": 30, "level_probability": 0.25}
    seeds = Study(count_down(5, 9, "1/5"), 100)


@pytest.mark.slow
class TestShrink(EstimatorConformance):
    estimator = "ess"
    options: ClassVar = {"chains": 15, "level_probability": 0.25, "kernel": "shrink"}
    studies = (Study(walk(1.0, 20), 300), Study(count_down(5, 9, "1/5"), 400))
    unsupported: ClassVar = {
        "test_interval_covers": "TestEss runs it; kernels share the interval",
        "test_impossible": "TestEss runs it; deep levels take their time",
        "test_json_has_no_nan": "TestEss runs it; deep levels take their time",
        "test_budget_is_kept": "its steps cost more the deeper it goes; a run is taken for one to 1e-4",
    }
