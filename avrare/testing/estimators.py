"""Conformance suite for estimators, as tests to inherit (docs/write-a-plugin.md).

    class TestMine(EstimatorConformance):
        estimator = "mine"
        options = {"particles": 50, "discard": 10}

A study that needs many seeds uses as many runs of one seed: run r draws from its own stream, keyed by
(seed, run), so runs are as independent as seeds; ``test_runs_are_a_prefix`` checks this.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

from avrare.base.errors import EveryRolloutBroke, UsageError
from avrare.estimation.estimate import estimate
from avrare.estimation.result.result import Result
from avrare.logic.formula import stl
from avrare.protocols import Floats
from avrare.rollout.problem import Problem
from avrare.testing import faulty_systems as systems
from avrare.testing.problems import (
    conjunction,
    count_down,
    ornstein_uhlenbeck,
    plus_minus,
    reach,
    response,
    walk,
)
from avrare.testing.reference_problem import ReferenceProblem
from avrare.testing.repeated_estimates import Audited, Study, coverage_at_most, deviation, standard_error
from avrare.testing.walk_problems import Lattice


def _tied(problem: ReferenceProblem) -> ReferenceProblem:
    return replace(problem, id=f"{problem.id}, all scores tied", score=systems.constant)


class EstimatorConformance:
    """Suite to subclass; every attribute may be replaced.

    Attributes:
        estimator: Name of an installed estimator.
        options: Options for small estimates: most tests use a problem of probability 0.02.
        reference: Problem of most tests, with a few dozen steps.
        studies: Studies of ``test_unbiased``; ``repeats`` is passed as ``runs``.
        seeds: Study of ``test_interval_covers``: ``repeats`` seeds, with the estimator's own number of runs.
        least_coverage: Share of 95 % intervals that must cover.
        widest: Largest ratio of upper end to truth of the median interval of ``seeds``.
        overshoot: Share of a budget by which the runs in hand may exceed it on ``reference``.
        unsupported: Tests to skip, with the reason: ``{"test_budget_is_kept": "it has one size"}``.
    """

    estimator: ClassVar[str] = "mc"
    options: ClassVar[Mapping[str, Any]] = {}
    reference: ClassVar[ReferenceProblem] = walk(1.0, 20)
    studies: ClassVar[tuple[Study, ...]] = (
        Study(walk(1.0, 20)),
        Study(_tied(walk(1.0, 20))),
        Study(ornstein_uhlenbeck(2.4, 20)),
        Study(count_down(5, 9, "1/5")),
        Study(plus_minus(10, 20, "2/5")),
        Study(reach(0.7, 20)),
        Study(response(8, 20, 1.5)),
        Study(conjunction(-1.5)),
    )
    seeds: ClassVar[Study] = Study(count_down(5, 9, "1/5"), 200)
    least_coverage: ClassVar[float] = 0.90
    widest: ClassVar[float] = 5.0
    overshoot: ClassVar[float] = 0.0
    unsupported: ClassVar[Mapping[str, str]] = {}

    def estimate(self, problem: Problem, **keywords: object) -> Result:
        """Run one estimate; override to test an estimator that is not installed under a name."""
        return estimate(problem, self.estimator, **{**self.options, **keywords})

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        unknown = [name for name in cls.unsupported if not (name.startswith("test_") and hasattr(cls, name))]
        if unknown:
            raise TypeError(f"{cls.__name__}.unsupported names no test of the suite: {', '.join(unknown)}")

    def pytest_generate_tests(self, metafunc: pytest.Metafunc) -> None:
        """Make one case of ``test_unbiased`` for each study."""
        if "study" in metafunc.fixturenames:
            metafunc.parametrize("study", self.studies, ids=[study.problem.id for study in self.studies])

    @pytest.fixture(autouse=True)
    def _skip_unsupported_test(self, request: pytest.FixtureRequest) -> None:
        reason = self.unsupported.get(request.node.originalname)
        if reason is not None:
            pytest.skip(reason)

    # Accuracy

    def test_unbiased(self, study: Study) -> None:
        """The mean is within four standard errors of the truth; a factor of two would be six away."""
        truth = study.problem.probability
        result = self.estimate(study.problem.problem(), seed=study.seed, runs=study.repeats, **study.options)
        values = result.run_probabilities
        assert values.shape == (study.repeats,), "every run counts, also those that died out"
        _assert_no_bias(values, truth)

    def test_interval_covers(self) -> None:
        """Intervals over many seeds cover the truth, up to binomial scatter."""
        study, truth = self.seeds, self.seeds.problem.probability
        results = [
            self.estimate(study.problem.problem(), seed=study.seed + i, **study.options)
            for i in range(study.repeats)
        ]
        bounds = np.array([result.interval for result in results])
        hits = int(((bounds[:, 0] <= truth) & (truth <= bounds[:, 1])).sum())
        chance = coverage_at_most(hits, study.repeats, self.least_coverage)
        # An estimator with exactly the least coverage is rejected in 1 of 1,000 cases.
        assert chance > 1e-3, f"{hits} of {study.repeats} intervals cover"
        widest = float(np.median(bounds[:, 1])) / truth
        assert widest < self.widest, f"the interval reaches {widest:.1f} times the truth: it says too little"
        z = deviation(np.array([result.probability for result in results]), truth)
        assert abs(z) < 4.0, f"the mean over seeds is {z:+.1f} standard errors off"

    def test_interval_widens_with_confidence(self) -> None:
        """The interval widens with its confidence and always contains the estimate."""
        result = self.estimate(self.reference.problem(), confidence=0.9)
        bounds = [result.interval_at(confidence) for confidence in (0.5, 0.9, 0.95, 0.999)]
        assert result.interval == bounds[1], "the interval does not have the confidence asked for"
        lows, highs = np.array(bounds).T
        assert (np.diff(lows) <= 0.0).all(), f"lower ends {lows}"
        assert (np.diff(highs) >= 0.0).all(), f"upper ends {highs}"
        assert 0.0 <= lows[-1] <= lows[0] <= result.probability <= highs[0] <= highs[-1] <= 1.0, bounds

    # Reproducibility

    def test_same_seed_same_bits(self) -> None:
        """The same seed gives the same bits, in small chunks and on two worker processes."""
        base = self.estimate(self.reference.problem(), seed=3)
        for chunk, workers in ((4096, 1), (17, 1), (40, 2)):
            other = self.estimate(self.reference.problem(chunk=chunk), seed=3, workers=workers)
            case = f"chunk={chunk}, workers={workers}"
            assert _without_seconds(base) == _without_seconds(other), case
            np.testing.assert_array_equal(base.failures.noise, other.failures.noise, case)
            np.testing.assert_array_equal(base.robustness, other.robustness, case)

    def test_other_seeds_differ(self) -> None:
        """No two seeds share their noise."""
        tapes = [self.estimate(self.reference.problem(), seed=seed, runs=2).worst.noise for seed in range(5)]
        assert len({tape.tobytes() for tape in tapes}) == 5, "seeds share a rollout"

    def test_runs_are_a_prefix(self) -> None:
        """Run r is the same among any number of runs."""
        few, many = (self.estimate(self.reference.problem(), runs=runs).run_probabilities for runs in (2, 7))
        assert len(set(many.tolist())) > 1, "the runs are equal: too weak a test, or they share their noise"
        np.testing.assert_array_equal(few, many[:2])

    def test_resumable(self, tmp_path: Path) -> None:
        """Killed repeatedly and resumed from its checkpoint, it gives the same bits."""
        immortal = self._mortal()
        uninterrupted = self.estimate(immortal, seed=3)
        lives, deaths = 60, 0
        while True:
            mortal = self._mortal(lives)
            try:
                resumed = self.estimate(mortal, seed=3, checkpoint=tmp_path / "checkpoint")
            except systems.Killed:
                lives, deaths = lives + lives // 2, deaths + 1  # terminates with any estimator
            else:
                break
        assert deaths, "the estimate was never interrupted: too weak a test"
        taken = [problem.system.lived for problem in (mortal, immortal)]
        assert taken[0] < taken[1], "nothing was stored: the last attempt took as many steps as the first"
        assert _without_seconds(uninterrupted) == _without_seconds(resumed)
        np.testing.assert_array_equal(uninterrupted.failures.noise, resumed.failures.noise)

    def _mortal(self, lives: float = math.inf) -> Any:
        system, formula = systems.Mortal(self.reference.system, lives), stl(self.reference.formula)
        return Problem(system, formula, self.reference.steps, self.reference.score, chunk=50)

    # Cost and consistency

    def test_cost_is_honest(self) -> None:
        """``simulated_steps`` counts the rows stepped, ``rollouts`` the rollouts asked for."""
        system = systems.Counting(self.reference.system)
        problem = Audited(system, stl(self.reference.formula), self.reference.steps, self.reference.score)
        result = self.estimate(problem)
        assert result.simulated_steps == problem.stepped, "simulated_steps is not what the system stepped"
        assert result.rollouts == problem.rollouts, "rollouts is not the number of starts and branches"

    @pytest.mark.parametrize("kind", ["steps", "rollouts"])
    def test_budget_is_kept(self, kind: str) -> None:
        """At least a third is used, and running runs exceed it by at most ``overshoot``."""
        amount = 100_000 if kind == "steps" else 5_000
        result = self.estimate(self.reference.problem(), budget={kind: amount})
        spent = result.simulated_steps if kind == "steps" else result.rollouts
        assert amount / 3 < spent <= amount * (1.0 + self.overshoot), f"{spent} of {amount} {kind}"

    def test_budget_too_small_is_refused(self) -> None:
        """A budget of one step, too small for a rollout, is refused."""
        with pytest.raises(UsageError):
            self.estimate(self.reference.problem(), budget="steps=1")

    def test_result_is_consistent(self) -> None:
        """The mean of the runs is the estimate, and lies in the interval."""
        result = self.estimate(self.reference.problem(), runs=3)
        low, high = result.interval
        assert result.probability == result.run_probabilities.mean(), "not the mean of the runs"
        assert [type(value) for value in (result.probability, low, high)] == [float] * 3
        assert 0.0 <= low <= result.probability <= high <= 1.0, (low, result.probability, high)
        assert len(result.failures.robustness) <= result.failures.count, "more tapes than failures"

    def test_failures_replay(self) -> None:
        """Failing tapes fail again in a replay, with the same robustness."""
        problem = self.reference.problem()
        failures = self.estimate(problem, runs=10).failures
        assert len(failures.robustness) > 0, "no failure was found: too weak a test"
        outcome = problem.replay(failures.noise)
        assert outcome.violated.all(), "a failing tape does not fail"
        np.testing.assert_array_equal(outcome.robustness[:, 0], failures.robustness)

    def test_json_has_no_nan(self) -> None:
        """The JSON holds no NaN, with and without failures."""
        for formula in ("always (x < 1)", "always (x < 1e9)"):
            result = self.estimate(_walk(formula))
            entry = json.loads(result.to_json(), parse_constant=_refuse)
            assert entry["probability"] == result.probability
            assert entry["interval"] == list(result.interval)

    def test_unknown_option_is_refused(self) -> None:
        """An unknown option is refused by its name."""
        with pytest.raises(UsageError, match="bananas"):
            self.estimate(self.reference.problem(), bananas=3)

    # Edge cases

    def test_impossible(self) -> None:
        """The estimate is 0, with an upper bound or a warning, also with all scores tied."""
        still = Problem(Lattice(0.5, 0.0, 0.0), stl("always (x < 1)"), 5)
        for problem in (_walk("always (x < 1e9)"), still):
            result = self.estimate(problem)
            low, high = result.interval
            assert (result.probability, low) == (0.0, 0.0), (result.probability, low)
            assert 0.0 < high <= 1.0, high
            assert high < 1.0 or result.health, "no upper bound, and no warning"

    def test_certain(self) -> None:
        """The estimate is 1, and the interval reaches it."""
        result = self.estimate(_walk("always (x < -1)"))
        low, high = result.interval
        assert (result.probability, high) == (1.0, 1.0), (result.probability, high)
        assert 0.0 < low < 1.0, low

    def test_unbiased_with_errors(self) -> None:
        """An error at random is neither failure nor pass, and is never drawn again."""
        task, truth, _ = _walk_with_errors()
        values = self.estimate(task, runs=400).run_probabilities
        _assert_no_bias(values, truth)

    def test_errors_are_counted(self) -> None:
        """All errors are counted, and in the upper end of the interval."""
        task, _, either = _walk_with_errors()
        result = self.estimate(task, runs=100)
        assert result.errors == task.errors > 0, f"{result.errors} of {task.errors} errors are counted"
        assert "errors" in result.health, "so many errors must raise a warning"
        assert result.interval[1] > 0.9 * either, "the upper end does not count errors as failures"

    @pytest.mark.parametrize("how", ["nan", "fault", "raise"])
    def test_errors_everywhere(self, how: str) -> None:
        """An estimate of a system that always breaks down ends after the first rollouts, and says why."""
        system = systems.Fragile(how, beyond=-np.inf)
        with pytest.raises(EveryRolloutBroke, match="each of the first"):
            self.estimate(Problem(system, stl("always (x < 1)"), 3))


def _assert_no_bias(values: Floats, truth: float) -> None:
    z = deviation(values, truth)
    assert abs(z) < 4.0, f"mean {values.mean():.3g}, truth {truth:.3g}: {z:+.1f} standard errors"
    assert standard_error(values) < truth / 12.0, "too weak a test: use more particles or repeats"


def _walk_with_errors() -> tuple[Audited, float, float]:
    """Return a walk with random errors, P(failure and no error), P(failure or error)."""
    chance, healthy = 0.01, walk(1.0, 20)
    survival = (1.0 - chance) ** healthy.steps
    task = Audited(systems.Fragile.with_chance(chance), stl(healthy.formula), healthy.steps)
    return task, healthy.probability * survival, 1.0 - (1.0 - healthy.probability) * survival


def _walk(formula: str) -> Problem:
    return Problem(systems.Walk(), stl(formula), 10)


def _without_seconds(result: Result) -> dict[str, object]:
    entry: dict[str, Any] = json.loads(result.to_json())
    del entry["seconds"]
    return entry


def _refuse(word: str) -> None:
    raise AssertionError(f"{word} is not JSON")
