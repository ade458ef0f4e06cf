"""The conformance suite on the estimators of this repository."""

from types import MappingProxyType

import pytest

from avrare.testing.estimators import EstimatorConformance
from avrare.testing.problems import count_down
from avrare.testing.repeated_estimates import Study


class TestMonteCarlo(EstimatorConformance):
    estimator = "mc"
    options = MappingProxyType({"rollouts": 200})


@pytest.mark.slow
class TestSplitting(EstimatorConformance):
    estimator = "ams"
    options = MappingProxyType({"particles": 50, "discard": 5})
    seeds = Study(count_down(5, 9, "1/5"), 200, {"discard": 10})
    unsupported = MappingProxyType(
        {"test_unbiased_with_errors": "an errored particle is never a parent, which lowers the estimate"}
    )
