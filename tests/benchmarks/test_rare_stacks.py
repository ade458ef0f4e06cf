"""Costs of estimates on stacks, for equal relative errors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from avrare.testing.problems import reference_problem
from benchmarks import rare_stacks
from benchmarks.studies import from_truth, stack_costs
from benchmarks.studies.levels import read_case
from benchmarks.studies.stack_costs import Costs, Outcome

ONE = Outcome(0, 1e-3, "is", 1.1e-3, 8e-4, 1.5e-3, 0.1, 10_000.0, 9000, (), 3.0)


def test_costs_are_those_of_a_relative_error_of_20_percent():
    few = Costs([ONE])
    assert few.monte_carlo == pytest.approx(24_975)
    # Four times the variance, a quarter of the rollouts.
    np.testing.assert_allclose(few.cost["stated"], [2500])
    assert list(few.cost) == ["stated"]
    many = Costs([replace(ONE, probability=p) for p in (0.8e-3, 0.9e-3, 1e-3, 1.1e-3, 1.2e-3)])
    assert many.cost["by scatter"].mean() == pytest.approx(0.02 * 10_000 / 0.04)
    assert many.best == pytest.approx(5000)


def test_estimates_of_zero_have_no_cost():
    extinct = Costs([ONE, replace(ONE, probability=0.0, relative_error=float("nan"), health=("extinct",))])
    assert extinct.cost == {}
    rows = stack_costs.table({"a stack": {"auto": Costs([ONE]), "ams": extinct}})
    assert "| no estimate |" in rows[-1]
    assert "| 0.10 |" in rows[-2]


def test_a_miss_by_a_factor_three_without_a_warning_misleads():
    off = replace(ONE, low=4e-3, high=5e-3)
    assert [ONE.covers, ONE.misleads, off.misleads] == [True, False, True]
    assert not replace(off, health=("unchecked",)).misleads


def test_what_auto_leaves_to_monte_carlo_is_answered_without_a_rollout(monkeypatch):
    problem = reference_problem("d_rw_L2.5").problem()

    def refuse(*_):
        raise AssertionError("a rollout was simulated")

    monkeypatch.setattr(type(problem.system), "step", refuse)
    results = [from_truth.estimate(problem, 0.03, seed, relative_error=0.1) for seed in range(8)]
    assert {result.estimator for result in results} == {"mc"}
    assert sum(result.interval[0] <= 0.03 <= result.interval[1] for result in results) >= 7
    assert all(result.simulated_steps > 102 / 0.06 * problem.steps for result in results)


def test_a_case_is_a_name_or_a_path_and_has_a_truth_or_a_number():
    _, known = read_case("glider_actuator:perches")
    assert known == pytest.approx(7.86e-4)
    path = str(rare_stacks.ROOT / "scenarios" / "glider_actuator.yaml")
    _, level = read_case(f"{path}:perches@1e-4")
    assert level == pytest.approx(1e-4)
    problem, given = read_case("glider_actuator:perches=0.5", ["steps=20"])
    assert (problem.steps, given) == (20, 0.5)


def test_every_cell_has_a_file_of_its_own():
    names = [name for _, _, name in rare_stacks.cells()]
    assert len(set(names)) == len(names) == 2 * len(rare_stacks.STACKS)
