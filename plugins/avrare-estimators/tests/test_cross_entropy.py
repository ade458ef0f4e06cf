"""Cross-entropy: its stages, its budget, and what it says when it has not arrived."""

import sys
from pathlib import Path

import numpy as np
import pytest

import avrare
from avrare.estimation.result import intervals

sys.path.insert(0, str(Path(__file__).parent))
import toy_closed_loop as toy

QUICK = {"epochs": 20, "rate": 5e-3, "hidden": 10, "rollouts": 150}
LIMIT = 6.0


def estimate(limit=LIMIT, **options):
    return avrare.estimate(toy.final_only(limit), "ce", **{**QUICK, **options})


def test_levels_rise_and_the_estimate_uses_a_sample_that_no_stage_has_seen():
    result = estimate(check=0.0)
    stages = result.diagnostics["stages"][0]
    levels = [stage["level"] for stage in stages if not stage["reached"]]
    assert levels == sorted(levels)
    assert stages[-1]["settled"]
    assert result.rollouts == 150 * (len(stages) + 1)
    assert result.diagnostics["rows"] == [150]


def test_not_reaching_failure_gives_a_warning():
    result = estimate(30.0, stages=2)
    assert len(result.diagnostics["stages"][0]) == 2
    assert "unchecked" in result.health
    assert result.interval[0] <= 1e-9 < 0.01 < result.interval[1]


def test_target_rows_of_every_stage_count():
    result = estimate(stages=2, check=0.0)
    target = 150 + 30 + 30  # the first stage, and the defensive rows of the second and of the final sample
    assert result.diagnostics["target_rows"] == [30]
    low, high = (intervals.clopper_pearson(failures, target, 0.95)[1] for failures in (0, 20))
    assert low <= result.blind_bound < high


def test_a_budget_covers_complete_stages_and_the_sample_takes_what_is_left():
    result = estimate(stages=4, budget="rollouts=2000", check=0.0)
    stages = len(result.diagnostics["stages"][0])
    assert result.diagnostics["rows"] == [400 * (5 - stages)]
    assert result.rollouts == 2000
    with pytest.raises(avrare.UsageError, match="does not pay"):
        estimate(stages=4, budget="rollouts=50")
    with pytest.raises(avrare.UsageError, match="clock"):
        estimate(budget="seconds=5")


def test_runs_are_a_prefix():
    few, many = (estimate(runs=runs, stages=2) for runs in (1, 2))
    np.testing.assert_array_equal(few.run_probabilities, many.run_probabilities[:1])


@pytest.mark.parametrize("wrong", [{"elite": 0.0}, {"hidden": 0}, {"elit": 0.1}])
def test_misuse(wrong):
    with pytest.raises(avrare.UsageError):
        estimate(**wrong)
