"""The conformance suite for slice sampling, importance sampling and sequential Monte Carlo."""

from typing import ClassVar

import pytest

from avrare.testing.estimators import EstimatorConformance
from avrare.testing.problems import conjunction, count_down, walk
from avrare.testing.repeated_estimates import Study


@pytest.mark.slow
class TestImportance(EstimatorConformance):
    estimator = "is"
    options: ClassVar = {"rollouts": 200, "proposal": {"name": "gaussian", "mean": 0.2}, "check": 0.0}
    studies = (Study(walk(1.0, 20), 200), Study(count_down(5, 9, "1/5"), 200), Study(conjunction(-1.5), 200))
    seeds = Study(walk(1.0, 20), 100, {"rollouts": 400})

    @pytest.mark.parametrize("how", ["nan", "fault", "raise"])
    def test_errors_everywhere(self, how):
        """Break down within the first part of a sample, which is a third of it."""
        self.options = {**self.options, "rollouts": 700}
        super().test_errors_everywhere(how)


@pytest.mark.slow
class TestSequentialMonteCarlo(EstimatorConformance):
    estimator = "smc"
    options: ClassVar = {"particles": 60, "runs": 4, "pilot": 400, "stages": 2, "times": 6}
    studies = (Study(walk(1.0, 20), 100), Study(count_down(5, 9, "1/5"), 100))
    seeds = Study(walk(1.0, 20), 60)
    unsupported: ClassVar = {
        "test_cost_is_honest": "test_smc.py counts them: rows go on in segments",
        "test_budget_is_kept": "test_smc.py counts them: it may be done with less",
    }


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
