"""The study of the lane change at levels of its truth."""

from __future__ import annotations

from dataclasses import asdict, replace

import pytest

from avrare.testing.problems import reference_problem
from benchmarks import rare_levels
from benchmarks.studies import from_truth, level_table
from benchmarks.studies.level_table import Outcome

ONE = Outcome(0, 1e-3, "is", 1.1e-3, 8e-4, 1.5e-3, 0.1, 50_000.0, 9000, 12.0, (), 3.0)


def test_what_auto_leaves_to_monte_carlo_is_answered_without_a_rollout(monkeypatch):
    problem = reference_problem("d_rw_L2.5").problem()

    def refuse(*_):
        raise AssertionError("a rollout was simulated")

    monkeypatch.setattr(type(problem.system), "step", refuse)
    found = [from_truth.estimate(problem, 0.03, seed, relative_error=0.1) for seed in range(8)]
    assert {one.estimator for one in found} == {"mc"}
    assert sum(one.interval[0] <= 0.03 <= one.interval[1] for one in found) >= 7
    assert all(one.simulated_steps > 102 / 0.06 * problem.steps for one in found)


def test_cells_come_cheap_first_and_what_is_there_is_not_made_again(tmp_path, monkeypatch):
    names = [cell.name for cell in rare_levels.cells()]
    assert len(set(names)) == len(names)
    assert names[0] == "safe_distance-own-0.2-auto"
    assert names.index("no_collision-1e-05-0.1-auto") > names.index("no_collision-1e-03-0.1-reused")
    made = []
    monkeypatch.setattr(
        rare_levels, "estimate", lambda cell, n, _: made.append((n, cell.name)) or replace(ONE, seed=n)
    )
    rare_levels.work(tmp_path, 1, "", 1.0)
    assert made == [(0, name) for name in names]
    rare_levels.work(tmp_path, 2, "", 1.0)
    assert made[len(names) :] == [(1, name) for name in names]
    rare_levels.work(tmp_path, 3, "", 0.0)
    assert len(made) == 2 * len(names)
    assert level_table.read(tmp_path / f"{names[0]}.jsonl") == [ONE, replace(ONE, seed=1)]


def test_a_row_compares_with_monte_carlo_at_the_error_that_was_reached():
    # At 10 % and 1e-3 Monte Carlo takes 99,900 rollouts: these results half as many.
    assert ONE.over_monte_carlo == pytest.approx(50_000 / 99_900)
    off = replace(ONE, seed=1, low=4e-3, high=5e-3)
    assert (ONE.covers, ONE.misleads, off.misleads, replace(off, health=("unchecked",)).misleads) == (
        True,
        False,
        True,
        False,
    )
    told = level_table.row("no_collision", 0.1, "auto", [ONE, off], 20)
    assert "| 2 of 20 | `is` 2 | 1.100 ± 0.000 | 1 | 0 | 1 |" in told
    assert "| 0.50 |" in told
    zero = replace(ONE, seed=2, probability=0.0, relative_error=float("nan"))
    assert "| none |" in level_table.row("no_collision", 0.1, "auto", [ONE, zero], 20)
    assert len(asdict(ONE)) == 12


def test_lines_of_a_page_are_put_between_its_marks(tmp_path):
    page = tmp_path / "page.md"
    page.write_text("a\n<!-- levels -->\nold\n<!-- end of levels -->\nb\n")
    level_table.put(page, "levels", ["new", "rows"])
    assert page.read_text() == "a\n<!-- levels -->\nnew\nrows\n<!-- end of levels -->\nb\n"
    with pytest.raises(ValueError, match="end of missing"):
        level_table.put(page, "missing", [])
