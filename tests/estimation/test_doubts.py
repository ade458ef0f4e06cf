"""A warning that doubts an estimate opens its interval; nothing else does."""

from dataclasses import replace
from functools import partial

import pytest

import avrare
from avrare.base.health_messages import MESSAGES
from avrare.estimation.checks.result_builder import contradict
from avrare.estimation.result import intervals
from avrare.estimation.result.doubts import (
    DOUBTS,
    MAY_MISS_FAILURES,
    MAY_SCATTER,
    answer_doubts,
    open_interval,
)
from avrare.estimation.result.fresh_rows import FreshRows
from avrare.plugin.registry import default_registry
from avrare.testing.problems import reference_problem

FRESH = FreshRows(rows=10_000, failures=1)


@pytest.fixture(scope="module")
def result():
    drawn = avrare.estimate(reference_problem("a_beta_-2").problem(), "mc", rollouts=100)
    at = lambda confidence: intervals.log_normal(1e-4, 0.01, confidence, freedom=20)  # noqa: E731
    return replace(drawn, probability=1e-4, interval_at=at, fresh=FRESH)


@pytest.mark.parametrize("name", sorted(DOUBTS))
def test_every_doubt_opens_the_upper_end_to_what_target_rows_allow(result, name):
    low, high = open_interval(result, [name]).interval
    assert high == FRESH.interval(0.95)[1] > result.interval[1]
    assert low == (result.interval[0] if name in MAY_MISS_FAILURES else pytest.approx(0.025 * 1e-4))


def test_an_interval_holds_what_a_check_has_found(result):
    assert open_interval(result, ["outliers"], least_upper=0.2).interval[1] == 0.2


def test_other_warnings_open_nothing(result):
    assert open_interval(result, ["all_failed", "errors", "horizon_short"]) is result
    assert open_interval(replace(result, fresh=None), ["outliers"]).interval == result.interval


def test_degenerate_weights_are_not_asked_for_their_scatter(result):
    wide = replace(result, interval_at=lambda confidence: (1e-9, 0.9))
    assert open_interval(wide, ["unchecked"]).interval[1] == 0.9
    assert open_interval(wide, ["weight_degenerate"]).interval[1] == FRESH.interval(0.95)[1]


@pytest.mark.parametrize(("rows", "failures"), [(10_000, 9), (400_000, 2)])
def test_target_rows_contradict_an_interval_that_lies_beside_theirs(result, rows, failures):
    found = replace(result, fresh=FreshRows(rows, failures))
    warning = contradict(found)
    assert f"{failures} of {rows} rollouts of the target failed" in warning["contradicted"]
    (low, high), counted = open_interval(found, warning).interval, found.fresh.interval(0.95)
    assert low <= counted[1]
    assert counted[0] <= high
    assert contradict(result) == {}


def test_at_most_twelve_warnings_doubt_an_interval_and_each_says_what_to_do():
    registry = default_registry()
    texts = dict(MESSAGES)
    for name in ("ams", "ess", "is"):
        texts |= registry.get("estimator", name).warnings
    assert len(DOUBTS) <= 12
    assert not MAY_MISS_FAILURES & MAY_SCATTER
    for name in DOUBTS - {"heuristic_kernel"}:  # its text is the kernel's
        assert any(word in texts[name] for word in ("use ", "compare with", "raise ")), name


@pytest.mark.parametrize("rows", [5_000, 100_000])
@pytest.mark.parametrize("name", ["unchecked", "contradicted"])
def test_target_rows_answer_a_doubt_of_missed_failures_that_they_bound(result, name, rows):
    doubted = replace(result, fresh=FreshRows(rows), health={name: "a reason", "errors": "many"})
    opened = open_interval(doubted, [name])
    answered = answer_doubts(opened)
    assert answered.interval == opened.interval
    if rows == 100_000 and name == "unchecked":
        assert list(answered.health) == ["errors"]
        assert answered.notes[-1].text.endswith("which see every failure: a reason.")
    else:
        assert answered is opened


def test_an_open_interval_is_never_narrowed_by_a_later_doubt():
    template = avrare.estimate(reference_problem("a_beta_-2").problem(), "mc", rollouts=100)
    at = partial(intervals.log_normal, 1e-4, 0.04, freedom=20)
    result = replace(template, probability=1e-4, interval_at=at, fresh=FreshRows(50_000))
    opened = open_interval(result, ["outliers"], least_upper=0.02)
    for later in (["contradicted"], ["weight_degenerate"]):
        low, high = open_interval(opened, later, least_upper=0.01).interval
        assert high >= 0.02
        assert low <= opened.interval[0]
