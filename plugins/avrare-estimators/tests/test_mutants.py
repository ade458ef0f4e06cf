"""Wrong readings of splitting that look right: the conformance suite must find each of them biased.

Each mutant changes one thing, and each is known from published code or a reading of the published algorithm.
"""

from dataclasses import replace
from types import MappingProxyType

import numpy as np
import pytest

from avrare.estimation.loop.loop import run
from avrare.estimation.plan.settings import Settings
from avrare.rollout.executors.serial import SerialExecutor
from avrare.testing.estimators import EstimatorConformance
from avrare.testing.problems import count_down, ornstein_uhlenbeck, walk
from avrare.testing.repeated_estimates import Study, deviation
from avrare_estimators.ams import splitting
from avrare_estimators.ams.config import AmsConfig
from avrare_estimators.ams.levels import Level, first_above
from avrare_estimators.ams.splitting import Splitting


class NominalWeight(Splitting):
    """Weighs by K, not by the number discarded."""

    def _reweight(self, state, discarded, level):
        super()._reweight(state, np.where(discarded > 0, self.config.discard, 0), level)


class ExactlyK(Splitting):
    """Discards exactly K: those that tie with the level survive, and a child branches where they reach it."""

    def _advance_level(self, state):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(splitting, "next_level", exactly_k)
            patch.setattr(splitting, "first_above", first_at_or_above)
            return super()._advance_level(state)


class BranchAtLevel(Splitting):
    """A child branches where its parent reaches the level, not where it exceeds it."""

    def _advance_level(self, state):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(splitting, "first_above", first_at_or_above)
            return super()._advance_level(state)


class RestartAtWorst(Splitting):
    """A child branches at the most critical step of its parent."""

    def _advance_level(self, state):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(splitting, "first_above", lambda scores, level: scores.argmax(axis=1))
            return super()._advance_level(state)


class OwnScore(Splitting):
    """A child branches where its parent exceeds the child's own old score, not the level."""

    def _branch(self, state, discarded, eligible, level):
        own = state.population.final[np.flatnonzero(discarded)]
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(splitting, "first_above", lambda scores, level: first_above(scores, own))
            return super()._branch(state, discarded, eligible, level)


class ExtinctDropped(Splitting):
    """Runs that died out are left out of the mean."""

    def estimate(self, state):
        (result,) = super().estimate(state)
        values = result.run_probabilities[result.run_probabilities > 0.0]
        return [replace(result, run_probabilities=values, probability=float(values.mean()))]


def exactly_k(score, violated, discard):
    order = np.lexsort((violated, score), axis=-1)
    kth = order[:, discard - 1 : discard]
    discarded = np.zeros(score.shape, dtype=bool)
    np.put_along_axis(discarded, order[:, :discard], True, axis=1)
    reached = np.take_along_axis(violated, kth, axis=1)[:, 0]
    return Level(np.take_along_axis(score, kth, axis=1)[:, 0], reached, discarded & ~reached[:, None])


def first_at_or_above(scores, level):
    above = scores >= level[:, None]
    return np.where(above.any(axis=1), above.argmax(axis=1), scores.shape[1] - 1)


def suite(kind, **options):
    """Return the conformance suite of an estimator that has no name."""

    class Suite(EstimatorConformance):
        def estimate(self, problem, *, seed=0, **keywords):
            estimator = kind(AmsConfig(**{**options, **keywords}))
            (self.result,) = run(problem, estimator, SerialExecutor(), Settings(seed))
            return self.result

    return Suite()


LATTICE, WALK, MEMORYLESS = count_down(5, 9, "1/5"), walk(1.0, 20), ornstein_uhlenbeck(2.4, 20)
FEW = MappingProxyType({"particles": 10, "discard": 2})
MANY = MappingProxyType({"particles": 50, "discard": 5})
HALF = MappingProxyType({"particles": 20, "discard": 10})
CASES = [
    (NominalWeight, LATTICE, FEW, 400),
    (NominalWeight, MEMORYLESS, MANY, 200),
    (ExactlyK, LATTICE, FEW, 300),
    (BranchAtLevel, LATTICE, FEW, 300),
    (RestartAtWorst, WALK, MANY, 400),
    (OwnScore, WALK, HALF, 400),
    (ExtinctDropped, LATTICE, FEW, 1500),
]


@pytest.mark.parametrize(("kind", "problem", "options", "runs"), CASES)
def test_a_mutant_is_detected(kind, problem, options, runs):
    tests = suite(kind, **options)
    with pytest.raises(AssertionError, match=r"standard errors|every run counts"):
        tests.test_unbiased(Study(problem, runs))
    z = deviation(tests.result.run_probabilities, problem.probability)
    assert abs(z) > 6.0, f"{z:+.1f} standard errors"


@pytest.mark.parametrize(("problem", "options"), [(LATTICE, FEW), (WALK, HALF), (MEMORYLESS, MANY)])
def test_the_original_passes(problem, options):
    suite(Splitting, **options).test_unbiased(Study(problem, 500))
