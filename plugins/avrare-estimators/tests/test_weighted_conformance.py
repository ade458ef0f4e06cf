"""The conformance suite for importance sampling."""

from typing import ClassVar

import pytest

from avrare.testing.estimators import EstimatorConformance
from avrare.testing.problems import conjunction, count_down, walk
from avrare.testing.repeated_estimates import Study


@pytest.mark.slow
class TestImportance(EstimatorConformance):
    estimator = "is"
    options: ClassVar = {"rollouts": 200, "proposal": {"name": "gaussian", "mean": 0.2}, "check": 0.0}
    studies = (
        Study(walk(1.0, 20), 200),
        Study(count_down(5, 9, "1/5"), 200),
        Study(conjunction(-1.5), 200),
    )
    seeds = Study(walk(1.0, 20), 100, {"rollouts": 400})
