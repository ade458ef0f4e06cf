"""The calibration benchmark: its problems have the answers they state, its shares count what they say."""

import importlib.util
import random
from collections import Counter

import numpy as np
import pytest

from avrare.testing.problems import reference_problem
from avrare_glider.config import GliderConfig, NoiseConfig
from avrare_glider.simulator import GliderSimulator
from benchmarks.calibration import cells, report, runner
from benchmarks.calibration.__main__ import BUDGETS, wanted
from benchmarks.calibration.answer import Counted, NoAnswerError, of_deviation, of_runs
from benchmarks.calibration.environments import interpreter
from benchmarks.calibration.problems import problems
from benchmarks.calibration.problems.driving import systems
from benchmarks.calibration.problems.problem import rolled
from benchmarks.calibration.report import KEPT
from benchmarks.calibration.summary import Row, best, rows_of
from benchmarks.calibration.tools import TOOLS
from benchmarks.studies import kept

SAME = {
    "conjunction_3": "a_beta_-3", "linear_d100_1e-09": "b_linear_d100_p1e-9",
    "four_branch_7": "c_fourbranch_k7",
    "walk_5.9": "d_rw_L5.9", "ou_6": "e_ou_L6.0", "count_T40_m15": "f1_count_T40_q1o10_m15",
    "walk_T100_m14": "f2_pm1walk_T100_q3o10_m14", "reach_0.25": "g_eventually_c0.25",
    "exponential_sum_40": "i_exp_sum_d10_c40.0", "response_80": "h_response_k80",
}  # fmt: skip


def test_problems_span_what_the_page_says():
    found = problems().values()
    assert len(found) >= 40
    assert {one.dimension for one in found} >= {2, 10, 100, 1000}
    assert min(one.probability for one in found) <= 1e-9 < 1e-2 <= max(one.probability for one in found)


@pytest.mark.parametrize("name", SAME)
def test_probabilities_and_robustness_are_those_of_the_reference(name):
    reference, problem = reference_problem(SAME[name]), problems()[name]
    assert problem.probability == pytest.approx(reference.probability, rel=1e-9)
    tapes = 1.5 * np.random.default_rng(3).standard_normal((300, problem.dimension))
    if reference.steps:
        whole = np.concatenate([np.zeros((300, 1)), tapes], axis=1)[:, :, None]
    else:
        whole = tapes[:, None, :]
    fails = reference.problem().robustness(whole) <= 0.0
    np.testing.assert_array_equal(problem.robustness(tapes) <= 0.0, fails)


def test_the_perching_glider_flies_as_that_of_its_plugin():
    simulator = GliderSimulator(GliderConfig(noise=NoiseConfig(actuator=0.15), feedback=None))
    tapes = 3.0 * np.random.default_rng(4).standard_normal((200, 66))
    world = simulator.reset(np.zeros((200, 1)))
    nearest = np.full(200, np.inf)
    for t in range(66):
        world = simulator.step(world, None, tapes[:, t : t + 1])
        signals = simulator.signals(world)
        nearest = np.minimum(nearest, np.abs(signals["x"]) + np.abs(signals["z"]))
    system = systems()["perching"][1]
    np.testing.assert_allclose(rolled(system, tapes), 0.05 - nearest, atol=1e-12)
    assert 0 < (nearest > 0.05).sum() < 200


@pytest.mark.parametrize("name", [one.name for one in problems().values() if one.probability > 1e-3])
def test_monte_carlo_agrees(name):
    problem, rows = problems()[name], 20_000
    tapes = np.random.default_rng(5).standard_normal((rows, problem.dimension))
    failures = (problem.robustness(tapes) <= 0).sum()
    expected = rows * problem.probability
    assert abs(failures - expected) < 5.0 * expected**0.5


@pytest.mark.parametrize("name", [one.name for one in problems().values() if one.system])
def test_scores_reach_one_at_failure_alone(name):
    problem = problems()[name]
    system, rows = problem.system, 200
    tapes = 2.0 * np.random.default_rng(2).standard_normal((rows, problem.dimension))
    noise = tapes.reshape(rows, system.steps, system.noise_size)
    state, highest = np.tile(np.asarray(system.start), (rows, 1)), np.full(rows, -np.inf)
    for t in range(system.steps):
        state = system.step(state, noise[:, t])
        highest = np.maximum(highest, system.score(state))
    np.testing.assert_array_equal(rolled(system, tapes) <= 0.0, highest >= 1.0)


def test_the_full_run_has_ten_answers_but_fewer_where_they_are_dear_or_a_variants():
    def count(seeds, tool="avrare ams"):
        keys = wanted(seeds, BUDGETS, quick=False, only=f"^{tool} walk_3.8$")
        return Counter((setting, budget) for _, setting, _, budget, _ in keys)

    answers = {("tuned", budget): 1 for budget in BUDGETS}
    answers |= {("recommended", budget): n for budget, n in zip(BUDGETS, (10, 10, 1), strict=True)}
    assert count(None) == answers
    assert list(count(None, "verifai cross-entropy").values()) == [10, 3, 1]
    assert set(count(3).values()) == {3}


def test_black_box_counts_and_stops():
    counted = Counted(problems()["walk_3.8"], 10)
    counted.robustness(np.zeros((7, 100)))
    counted.step(np.zeros((50, 1)), np.zeros((50, 1)))
    assert counted.evaluations == pytest.approx(7.5)
    with pytest.raises(NoAnswerError, match="10 times the budget"):
        counted.robustness(np.zeros((100, 100)))


def test_intervals_from_deviations_and_runs():
    low, high = of_deviation(1e-4, 0.3).interval
    assert low * high == pytest.approx(1e-8)
    assert of_deviation(1e-4, float("nan")).interval is None
    assert of_runs([0.0] * 10).interval is None
    low, high = of_runs([1.0, 2.0, 3.0, 4.0, 5.0]).interval
    assert (low, high) == pytest.approx((3.0 - 1.9633, 3.0 + 1.9633), abs=1e-3)


def test_every_tool_has_an_adapter():
    for tool in TOOLS.values():
        assert importlib.util.find_spec(tool.module)


def cell(estimate, low, high, warnings=(), seed=0, tool="avrare mc", evaluations=1000.0):
    found = estimate, low, high, warnings, evaluations, 0.1, ""
    return cells.Cell(tool, "1", "recommended", "walk_2.5", 1000, seed, *found)


def test_first_is_the_cheapest_that_may_be_trusted():
    p, problem = problems()["walk_2.5"].probability, problems()["walk_2.5"]

    def row(tool, ratios, evaluations, width=2.0):
        return Row(tool, "recommended", problem, 1000, tuple(
            cell(r * p, r * p / width, r * p * width, (), seed, tool, evaluations)
            for seed, r in enumerate(ratios)
        ))  # fmt: skip

    dear, cheap = row("a", (0.9, 1.1, 1.0, 1.05), 4000.0), row("b", (0.9, 1.1, 1.0, 1.05), 1000.0)
    wrong = row("c", (0.2, 0.2, 0.2, 0.21), 10.0, 1.1)
    assert best([dear, cheap, wrong]) is cheap


def test_a_worker_that_does_not_answer_is_a_cell_with_a_reason(tmp_path, monkeypatch):
    monkeypatch.setattr(runner, "_START", 0.0)
    maker = runner.Runner(tmp_path, 0.0)
    found = maker.cell(("avrare mc", "recommended", "walk_2.5", 1000, 0))
    assert found.estimate is None
    assert found.reason == "no answer within 0 CPU seconds"
    assert not maker.workers


def test_the_tables_have_every_row():
    p = problems()["walk_2.5"].probability
    tools = [*list(TOOLS)[:2], *list(TOOLS)[-5:]]
    rows = rows_of(
        cell((0.9 + 0.1 * seed) * p, p / 2, 2 * p, (), seed, tool) for seed in range(3) for tool in tools
    )
    assert len(report.cell_table(rows)) == len(tools)
    shown = [line.split(" | ")[0] for line in report.shown_lines(rows)[2:]]
    assert shown == [f"| {tool}" for tool in sorted(tools)]
    (line,) = report.first_table(rows)
    assert (line["problem"], line["first"], line["behind"]) == ("walk_2.5", "avrare ams", "")
    assert not report.first_table(rows[:-1])
    assert len(report.problem_table()) == len(problems())


def agree(one, other):
    """Return whether two answers differ by no more than their errors explain."""
    small, large = sorted((one, other), key=lambda answer: answer.estimate)
    reach = np.hypot(small.high - small.estimate, large.estimate - large.low)
    return large.estimate - small.estimate <= reach


@pytest.mark.slow
@pytest.mark.parametrize("turn", range(3))
def test_kept_cells_are_made_again(tmp_path, turn):
    kept.unpack(KEPT, tmp_path / "kept")
    cheap = [
        one for one in cells.read(tmp_path / "kept")
        if one.estimate and one.low and one.seconds < 2.0
        and one.tool in TOOLS and interpreter(TOOLS[one.tool].environment)
    ]  # fmt: skip
    tool = random.Random(turn).choice(sorted({one.tool for one in cheap}))
    mine = sorted((one for one in cheap if one.tool == tool), key=lambda one: one.key)
    old = random.Random(turn).choice(mine)
    maker = runner.Runner(tmp_path, 600.0)
    again = maker.cell(old.key)
    for worker in maker.workers.values():
        worker.kill()
    assert again.estimate is not None
    # The same seed gives the same bits with the same versions; with others two answers that agree.
    assert again.estimate == old.estimate or agree(again, old)
