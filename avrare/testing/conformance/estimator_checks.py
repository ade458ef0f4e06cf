"""Estimator checks on problems with known answers: a short form of ``avrare.testing.estimators``."""

from __future__ import annotations

from collections.abc import Callable
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any

import numpy as np

from avrare.base.chart import Chart
from avrare.testing.conformance.suite import Skipped, Subject
from avrare.testing.problems import count_down, walk
from avrare.testing.repeated_estimates import Study

if TYPE_CHECKING:
    from avrare.testing.estimators import EstimatorConformance

_REPEATS = 150
"""Runs of a study; the suite in the tests of a plugin has 400."""


def unbiased_on_a_walk(subject: Subject) -> None:
    """The mean over many runs is the exact probability of a random walk, within four standard errors."""
    _suite(subject).test_unbiased(Study(walk(1.0, 20), _REPEATS))


def unbiased_with_ties(subject: Subject) -> None:
    """The mean over many runs is exact where many particles share a score, and runs die out."""
    _suite(subject).test_unbiased(Study(count_down(5, 9, "1/5"), _REPEATS))


def interval_covers(subject: Subject) -> None:
    """At least 90 % of its 95 % intervals, over many seeds, contain the exact probability."""
    _suite(subject).test_interval_covers()


def impossible_is_zero(subject: Subject) -> None:
    """An impossible failure has the estimate 0, with an upper bound or a warning."""
    _suite(subject).test_impossible()


def certain_is_one(subject: Subject) -> None:
    """A certain failure has the estimate 1."""
    _suite(subject).test_certain()


def errors_are_no_failures(subject: Subject) -> None:
    """Errors are counted, and raise only the upper end of the interval."""
    suite = _suite(subject)
    suite.test_errors_are_counted()
    for how in ("nan", "fault", "raise"):
        suite.test_errors_everywhere(how)


def cost_is_honest(subject: Subject) -> None:
    """It reports the steps that the system took and the rollouts that it asked for."""
    _suite(subject).test_cost_is_honest()


def budget_is_kept(subject: Subject) -> None:
    """A budget of steps or rollouts is used and kept; one too small for a rollout is refused."""
    suite = _suite(subject)
    for kind in ("steps", "rollouts"):
        suite.test_budget_is_kept(kind)
    suite.test_budget_too_small_is_refused()


def same_seed_same_bits(subject: Subject) -> None:
    """The same seed gives the same bits, in chunks of any size."""
    suite = _suite(subject)
    large, small = (suite.estimate(walk(1.0, 20).problem(chunk=size), seed=3) for size in (4096, 17))
    for name in ("probability", "interval", "rollouts", "simulated_steps", "errors"):
        first, second = getattr(large, name), getattr(small, name)
        assert first == second, f"{name} is {first} in large chunks, {second} in small ones"
    assert np.array_equal(large.failures.noise, small.failures.noise), "other failures in small chunks"


def runs_are_a_prefix(subject: Subject) -> None:
    """Run r is the same among any number of runs."""
    _suite(subject).test_runs_are_a_prefix()


def failures_replay(subject: Subject) -> None:
    """Its stored failing tapes fail again, with the same robustness."""
    _suite(subject).test_failures_replay()


def results_are_consistent(subject: Subject) -> None:
    """The estimate is the mean of its runs, lies in the interval, and its JSON holds no NaN."""
    suite = _suite(subject)
    suite.test_result_is_consistent()
    suite.test_interval_widens_with_confidence()
    suite.test_json_has_no_nan()


def charts_are_drawn(subject: Subject) -> None:
    """The charts that it declares are drawn from its results."""
    charts = resolve_name(subject.component.charts)(_suite(subject).estimate(walk(1.0, 20).problem(), seed=0))
    assert all(isinstance(chart, Chart) for chart in charts), "not all of them are avrare.base.chart.Chart"


def unknown_options_are_refused(subject: Subject) -> None:
    """An unknown option is refused by its name."""
    _suite(subject).test_unknown_option_is_refused()


def _suite(subject: Subject) -> EstimatorConformance:
    try:
        from avrare.testing.estimators import EstimatorConformance
    except ImportError as error:
        raise Skipped(f"needs {error.name}: pip install pytest") from None
    subject.build()
    set_options: dict[str, Any] = subject.config.model_dump(exclude_unset=True)

    class Quick(EstimatorConformance):
        estimator = subject.name
        options = set_options
        seeds = Study(count_down(5, 9, "1/5"), 60)
        overshoot = 0.5  # the tests of the plugin may be stricter

    return Quick()


CHECKS: tuple[Callable[[Subject], None], ...] = (
    unbiased_on_a_walk, unbiased_with_ties, interval_covers, impossible_is_zero, certain_is_one,
    errors_are_no_failures, cost_is_honest, budget_is_kept, same_seed_same_bits, runs_are_a_prefix,
    failures_replay, results_are_consistent, charts_are_drawn, unknown_options_are_refused,
)  # fmt: skip
