"""Forty problems with exact answers: plain Monte Carlo agrees, and the study resumes and counts."""

import json
from dataclasses import asdict

import numpy as np
import pytest
from scipy.stats import binom

from benchmarks.unseen.problems import CASES
from benchmarks.unseen.report import print_report
from benchmarks.unseen.study import Outcome, Task, read_outcomes, run_study
from benchmarks.unseen.truths import FILE, stored

NUMBERS_PER_PART = 10_000_000
SLOW = {"follow_gap", "checksum", "gusts", "near_miss"}
TOY = """
from benchmarks.unseen.problems.static import UltrasonicSum
CASES = {"toy": lambda: (UltrasonicSum().problem(), 6.48e-5)}
"""


def test_forty_problems_have_a_meaning_and_a_probability():
    entries = json.loads(FILE.read_text())
    assert set(entries) == set(CASES)
    assert len(entries) == 40
    assert sum(case.steps == 0 for case in CASES.values()) == 10
    assert sum(case.hidden for case in CASES.values()) == 6
    for name, entry in entries.items():
        assert 1e-6 <= entry["probability"] <= 1e-2, name
        assert entry["relative_difference"] < 0.01, name
        assert entry["method"] == CASES[name].method
        assert CASES[name].method in {"closed form", "quadrature", "dynamic programming"}
        assert CASES[name].__doc__.endswith(".")
    assert sum(1e-5 <= entry["probability"] <= 1e-3 for entry in entries.values()) > 25


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("rows", [40_000, pytest.param(200_000, marks=pytest.mark.slow)])
def test_monte_carlo_agrees(name, rows):
    case, rng = CASES[name], np.random.default_rng([7, *name.encode()])
    rows = 200_000 if case.steps == 0 and case.noise_size < 100 else rows
    problem, size, failures, left = case.problem(), (case.steps + 1) * case.noise_size, 0, rows
    while left:
        part = min(left, max(NUMBERS_PER_PART // size, 1))
        rollouts = problem.replay(rng.standard_normal((part, case.steps + 1, case.noise_size)))
        failures += int(rollouts.violated.sum())
        left -= part
    low, high = binom.ppf([1e-4, 1 - 1e-4], rows, stored()[name])
    assert low <= failures <= high


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=[pytest.mark.slow] if name in SLOW else []) for name in CASES],
)
def test_a_probability_is_computed_again(name):
    assert CASES[name].exact() == pytest.approx(stored()[name], rel=2e-3)


@pytest.mark.parametrize("name", CASES)
def test_rows_do_not_depend_on_the_batch(name):
    case, rng = CASES[name], np.random.default_rng(3)
    noise = 1.5 * rng.standard_normal((37, case.steps + 1, case.noise_size))
    problem = case.problem()
    whole = problem.robustness(noise)
    assert not np.isnan(whole).any()
    parts = [problem.robustness(part) for part in (noise[:1], noise[1:12], noise[12:])]
    np.testing.assert_array_equal(np.concatenate(parts), whole)
    state = case.initial(noise[:, 0])
    for t in range(1, case.steps + 1):
        state = case.step(state, noise[:, t])
    assert all(np.isfinite(values).all() for values in case.signals(state).values())


def test_the_report_tells_confident_from_warned_errors(capsys):
    def outcome(seed, low, high, *names, problem="a", used=None):
        task = Task("c", problem, "auto", seed, "")
        return Outcome(task, 1e-3, 2e-3, low, high, 1000.0, used, 1.0, list(names))

    right, near, far = (0.5e-3, 3e-3), (1.1e-3, 3e-3), (4e-3, 8e-3)
    outcomes = [outcome(0, *right), outcome(1, *near), outcome(2, *far), outcome(3, *far, "unchecked")]
    print_report("auto", [*outcomes, outcome(0, *right, problem="b", used=0.5)], {"b"})
    rows = {line.split()[0]: line.split() for line in capsys.readouterr().out.splitlines() if line}
    assert rows["a"] == ["a", "1.0e-03", "4", "2.00", "3", "33", "25", "0", "1", "1", "2", "1.001", "1,000"]
    assert rows["b"] == ["b", "*", "1.0e-03", "1", "2.00", "1", "100", "0", "0", "0", "1.001", "0.50"]


def test_a_study_runs_what_is_missing(tmp_path, capsys):
    file = tmp_path / "toy.py"
    file.write_text(TOY)
    tasks = [Task("c", "toy", "mc", seed, "rollouts=1000") for seed in range(2)]
    present = Outcome(tasks[0], 6.48e-5, 0.0, 0.0, 0.0036, 1000.0, 1.0, 0.1, [])
    (tmp_path / "mc.jsonl").write_text(json.dumps(asdict(present)) + "\n" + '{"task": ["torn')
    run_study(tasks, tmp_path, str(file), 1)
    outcomes = read_outcomes(tmp_path / "mc.jsonl")
    assert [outcome.task for outcome in outcomes] == tasks
    assert all(outcome.covers and outcome.used == 1.0 and outcome.cost == 1000 for outcome in outcomes)
    assert "1/1 toy mc seed 1" in capsys.readouterr().out
