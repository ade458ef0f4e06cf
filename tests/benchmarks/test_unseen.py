"""Forty problems with exact answers: plain Monte Carlo agrees, and the study resumes and counts."""

import json
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import binom

import avrare
from benchmarks.unseen import sources
from benchmarks.unseen.problems import CASES
from benchmarks.unseen.report import list_goals, print_forecast, print_report, write_summary
from benchmarks.unseen.sets import find_names, find_problem
from benchmarks.unseen.sources import digest_of
from benchmarks.unseen.study import Outcome, Task, adopt, decide_at, find_missing, read_all, run_study
from benchmarks.unseen.truths import FILE, stored

READ_TEXT = Path.read_text
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
    "name", [pytest.param(name, marks=[pytest.mark.slow] if name in SLOW else []) for name in CASES]
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


@pytest.mark.parametrize("name", ["cubic_4.6", "many_modes"])
def test_monte_carlo_agrees_on_problems_of_the_gate(name):
    problem, probability = find_problem(name)
    rows = 400_000
    noise = np.random.default_rng(2).standard_normal((rows, 1, problem.noise_size))
    low, high = binom.ppf([1e-4, 1 - 1e-4], rows, probability)
    assert low <= problem.replay(noise).violated.sum() <= high
    whole = problem.robustness(noise[:100])
    np.testing.assert_array_equal([problem.robustness(row[None])[0] for row in noise[:100]], whole)


def test_every_set_has_problems_with_names_of_their_own():
    names = [name for key in ("unseen", "untuned", "reference", "extra") for name in find_names(key)]
    assert len(set(names)) == len(names)
    assert len(find_names("unseen")) == 40
    assert len(find_names("untuned")) == 32
    assert len(find_names("lattice")) == 10
    assert set(find_names("lattice") + find_names("gate")) <= set(names)
    assert find_names("plain_walk,gate")[:2] == ["plain_walk", "cubic_4.6"]


def result(seed, low, high, *names, problem="a", used=None, verdict="inconclusive"):
    task = Task("c", problem, "auto", seed)
    return Outcome(task, 1e-3, 2e-3, low, high, 1000.0, used, 1.0, list(names), verdict, "is")


RIGHT, NEAR, FAR = (0.5e-3, 3e-3), (1.1e-3, 3e-3), (4e-3, 8e-3)


def test_the_report_tells_confident_from_warned_errors(capsys):
    outcomes = [result(0, *RIGHT), result(1, *NEAR), result(2, *FAR), result(3, *FAR, "unchecked")]
    outcomes.append(result(0, *RIGHT, problem="b", used=0.5, verdict="pass_assuming"))
    print_report("auto", outcomes, {"b"})
    rows = {line.split()[0]: line.split() for line in capsys.readouterr().out.splitlines() if line}
    assert " ".join(rows["a"]) == "a 1.0e-03 4 is 4 2.000 2.00 3 33 33 25 0 1 1 2 1.001 1.001 0 1,000 1.00"
    assert " ".join(rows["b"]) == "b * 1.0e-03 1 is 1 2.000 2.00 1 100 0 0 0 0 1.001 1.001 100 0.50 1.00"


def test_goals_count_what_is_confidently_wrong_and_covered_too_seldom():
    missed = [result(seed, *FAR, problem="b") for seed in range(10)]
    outcomes = [*missed, *(result(10 + seed, *RIGHT, problem="b") for seed in range(40))]
    outcomes += [result(seed, *FAR, "unchecked", used=1.2) for seed in range(50)]
    measured = {goal: text for goal, _, text in list_goals(outcomes, {"b"})}
    assert measured["problems whose quiet coverage is too low"] == "b 40/50"
    assert measured["confidently wrong"] == "0 of 50"
    assert measured["of hidden combinations"] == "10 of 50"
    assert measured["warned [%]"] == "50.0"
    assert measured["warned and narrow"] == "50 of 50"
    assert measured["largest cost over the budget"] == "1.20"


def test_a_threshold_at_the_truth_passes_where_the_interval_is_below(monkeypatch):
    problem, _ = find_problem("latched_brake")
    estimate = avrare.estimate(problem, "mc", rollouts=4000)
    assert decide_at(estimate, 2 * estimate.interval[1]) == "pass"
    assert decide_at(estimate, estimate.probability) == "inconclusive"
    assert decide_at(estimate, estimate.interval[0] / 2) == "fail"


def test_the_digest_of_an_estimator_follows_its_code_and_not_its_comments(monkeypatch):
    def digest_with(change):
        digest_of.cache_clear()
        monkeypatch.setattr(sources.Path, "read_text", lambda path, encoding: change(path, READ_TEXT(path)))
        return digest_of("mc")

    now = digest_with(lambda path, text: text)
    assert digest_with(lambda path, text: f"{text}\n# a remark\n") == now
    assert digest_with(lambda path, text: f"{text}\n{'x = 1' * (path.name == 'intervals.py')}") != now
    assert digest_with(lambda path, text: f"{text}\n{'x = 1' * (path.name == 'splitting.py')}") == now
    digest_of.cache_clear()


def test_the_forecast_is_in_hours_of_what_is_missing(capsys):
    tasks = [Task("new", "a", "auto", seed) for seed in range(100)]
    print_forecast(find_missing(tasks, [result(0, *RIGHT)]), [replace(result(0, *RIGHT), seconds=36.0)])
    assert capsys.readouterr().out.splitlines()[1].split() == ["auto", "a", "100", "36.0", "1.00"]


def test_a_study_runs_what_is_missing(tmp_path, capsys):
    file = tmp_path / "toy.py"
    file.write_text(TOY)
    tasks = [Task("c", "toy", "mc", seed, "rollouts=1000") for seed in range(2)]
    present = Outcome(tasks[0], 6.48e-5, 0.0, 0.0, 0.0036, 1000.0, 1.0, 0.1, [])
    (tmp_path / "mc.jsonl").write_text(json.dumps(asdict(present)) + "\n" + '{"task": ["torn')
    run_study(find_missing(tasks, read_all(tmp_path)), tmp_path, str(file), 1)
    outcomes = read_all(tmp_path)
    assert [outcome.task for outcome in outcomes] == tasks
    assert all(outcome.covers and outcome.used == 1.0 and outcome.cost == 1000 for outcome in outcomes)
    assert "1/1 toy mc seed 1" in capsys.readouterr().out
    adopt(outcomes[1:], "d", tmp_path, str(file))
    assert read_all(tmp_path)[2].task == tasks[1]._replace(digest="d")
    with pytest.raises(ValueError, match="toy seed 0 differs"):
        adopt([replace(outcomes[0], probability=0.5)], "d", tmp_path, str(file))
    write_summary(tmp_path / "rows.csv", outcomes)
    assert (
        (tmp_path / "rows.csv").read_text().splitlines()[1].startswith("mc,rollouts=1000,{},c,toy,6.5e-05,2,")
    )
