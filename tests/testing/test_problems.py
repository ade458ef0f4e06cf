"""The reference problems: what they are, how likely they fail, and that their systems do just that."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from scipy.special import ndtr

import avrare
from avrare.testing import exact_chain_probabilities as chain
from avrare.testing.problems import (
    conjunction,
    count_down,
    exponential_sum,
    four_branch,
    linear,
    lognormal_product,
    ornstein_uhlenbeck,
    plus_minus,
    reach,
    reference_problem,
    reference_problems,
    response,
    walk,
)

ENTRIES = json.loads((Path(__file__).parents[1] / "data" / "reference_problems.json").read_text())["problems"]
PROBLEMS = {problem.id: problem for problem in reference_problems()}
SMALL = [
    walk(0.7, 12), ornstein_uhlenbeck(2.0, 12, decay=0.5), count_down(3, 12, "1/10"),
    plus_minus(5, 12, "1/3"), reach(0.3, 12), response(3, 12, 1.5), conjunction(-1.2), linear(2.0, 7),
    four_branch(3.0), exponential_sum(9.0, 4), lognormal_product(4.0, 3, 0.7),
]  # fmt: skip
by_id = pytest.mark.parametrize("problem", [*PROBLEMS.values()], ids=lambda problem: problem.id)
small = pytest.mark.parametrize("problem", SMALL, ids=lambda problem: problem.id)


def tapes(problem, rows, seed=0):
    shape = (rows, problem.steps + 1, problem.system.noise_size)
    return np.random.default_rng(seed).normal(size=shape)


def test_the_table_is_the_published_one():
    assert [entry["id"] for entry in ENTRIES] == list(PROBLEMS)
    for entry in ENTRIES:
        problem = PROBLEMS[entry["id"]]
        assert problem.probability == entry["p"]
        assert problem.steps == entry.get("T", 0)
        assert problem.system.noise_size == (1 if problem.steps else entry["dim"])


@by_id
def test_our_own_computation_agrees(problem):
    assert problem.exact() == pytest.approx(problem.probability, rel=1e-9)


def published_event(entry, noise):
    """Return the failure of each tape (N,), from the published definition alone."""
    kind, w = entry["id"][:1], noise[:, 0]
    if kind == "a":
        return np.minimum(np.abs(w[:, 0]), w[:, 1]) + entry["beta"] >= 0
    if kind == "b":
        return entry["b"] - w.sum(axis=1) / 10.0 <= 0
    if kind == "c":
        u, v, k = w[:, 0], w[:, 1], entry["k"]
        curve, line = 3 + 0.1 * (u - v) ** 2, k / math.sqrt(2)
        terms = curve - (u + v) / math.sqrt(2), curve + (u + v) / math.sqrt(2), u - v + line, v - u + line
        return np.min(terms, axis=0) <= 0
    if kind == "i":
        if "sigma" in entry:
            return entry["c"] - np.prod(np.exp(0.5 * w), axis=1) <= 0
        return entry["c"] - np.sum(-np.log(ndtr(-w)), axis=1) <= 0
    return published_course(entry, noise[:, 1:, 0])


def published_course(entry, w):
    """Return the same for the problems with a course, from w (N, T)."""
    x = np.stack(list(positions(entry, w)), axis=1)
    if "L" in entry:
        return (x[:, 1:] >= entry["L"]).any(axis=1)
    if "m" in entry:
        return (x <= -entry["m"]).any(axis=1)
    if "c" in entry:
        return (x[:, 1:] < entry["c"]).all(axis=1)
    k = entry["k"]
    return np.any([(x[:, t] >= 2) & (x[:, t : t + k + 1] > 0).all(axis=1) for t in range(101 - k)], axis=0)


def positions(entry, w):
    decay, drift, scale = {"d": (1, 0, 0.1), "g": (1, 0.1, 0.2)}.get(entry["id"][0], (0.9, 0, 0.19**0.5))
    x = np.full(len(w), float(entry["x0"]))
    yield x
    for column in w.T:
        if "q" in entry:
            numerator, denominator = map(int, entry["q"].split("/"))
            fell = ndtr(column) < numerator / denominator
            x = x + 1 - 2 * fell if "walk" in entry["id"] else x - fell
        else:
            x = decay * x + drift + scale * column
        yield x


def stretched(problem, entry, rows):
    """Return tapes on which failures are common: ordinary ones, pushed towards the failure by any amount."""
    noise = tapes(problem, rows)
    push = np.linspace(0.0, 1.0, rows)[:, None, None]
    towards = {"c": 0.0, "f": -3.0, "g": -0.6, "h": 0.3, "i": 4.5, "a": 3.0, "b": 0.7, "d": 0.7, "e": 1.5}
    scale = 1.0 + (3.0 * push if entry["id"][0] == "c" else 0.0)
    return noise * scale + push * towards[entry["id"][0]]


@by_id
def test_systems_and_formulas_match_the_published_definitions(problem):
    entry = next(entry for entry in ENTRIES if entry["id"] == problem.id)
    noise = stretched(problem, entry, 400)
    expected = published_event(entry, noise)
    assert 10 < expected.sum() < 390, f"{expected.sum()}: the test shows nothing"
    outcome = problem.problem().replay(noise)
    np.testing.assert_array_equal(outcome.violated[:, 0], expected)
    robustness = outcome.robustness[:, 0]
    np.testing.assert_array_equal(robustness < 0 if problem.relation == "<0" else robustness <= 0, expected)


@pytest.mark.parametrize(
    "problem",
    [
        walk(0.1, 40), ornstein_uhlenbeck(3.0, 30, decay=-0.8), ornstein_uhlenbeck(0.5, 5, decay=0.0),
        reach(-2.0, 10), reach(9.0, 1), response(4, 9, 0.3, start=0.2), response(2, 8, 2.0, 0.9999, 1.5),
    ],
    ids=lambda problem: problem.id,
)  # fmt: skip
def test_a_finer_integration_finds_the_same(problem, monkeypatch):
    before = problem.exact()
    monkeypatch.setattr(chain, "_PANEL", 0.9)
    monkeypatch.setattr(chain, "_DEVIATIONS", 11.0)
    assert problem.exact() == pytest.approx(before, rel=1e-11)


@small
def test_generators_against_monte_carlo(problem):
    truth, rollouts = problem.probability, 200_000 if problem.steps == 0 else 50_000
    assert 1e-3 < truth < 0.5
    found = avrare.estimate(problem.problem(), seed=3, rollouts=rollouts).probability
    assert abs(found - truth) < 4 * math.sqrt(truth * (1 - truth) / rollouts)


COMMON = [problem for problem in PROBLEMS.values() if problem.probability > 1e-3]


@pytest.mark.parametrize("problem", COMMON, ids=lambda problem: problem.id)
def test_reference_problems_against_monte_carlo(problem):
    rollouts = {"response": 4_000}.get(problem.family, 20_000 if problem.steps else 200_000)
    truth = problem.probability
    found = avrare.estimate(problem.problem(), seed=5, rollouts=rollouts).probability
    assert abs(found - truth) < 4 * math.sqrt(truth * (1 - truth) / rollouts)


def test_generated_and_tabled_problems_agree():
    assert walk(2.5).probability == pytest.approx(reference_problem("d_rw_L2.5").probability, rel=1e-12)
    assert walk(2.5).published is None


def test_a_custom_score_replaces_the_suggested_one():
    problem = reference_problem("g_eventually_c0.5")
    assert problem.problem().score is problem.score
    assert problem.problem("robustness", chunk=7).score == "robustness"
    assert problem.problem(chunk=7).chunk == 7


def test_response_scores_rise_to_two_at_the_failure():
    problem = response(3, 8, 1.5)
    x = np.array([[0.5, 1.6, 0.2, 0.1, 0.1, -1, 0, 0, 0], [0.5, 0.9, 1.6, 0.1, -0.1, 1.2, 1.6, 2, 2]])
    scores = [problem.score({"x": x[:, : t + 1]}, t) for t in range(9)]
    first, second = np.transpose(scores)
    np.testing.assert_allclose(first[:5], [1 / 3, 1.0, 4 / 3, 5 / 3, 2.0])
    np.testing.assert_allclose(second[:6], [1 / 3, 0.6, 1.0, 4 / 3, -0.1 / 1.5, 0.8])
    assert np.isneginf(second[6:]).all(), "a trigger after step 5 has no time to fail"


def test_unknown_ids_and_impossible_arguments():
    with pytest.raises(avrare.UsageError, match="d_rw_L2") as caught:
        reference_problem("d_rw_L2")
    assert caught.value.hint == "did you mean 'd_rw_L2.5'?"
    for wrong in (lambda: walk(0.0), lambda: walk(1.0, 0), lambda: reach(1.0, 0), lambda: response(10, 10)):
        with pytest.raises(avrare.UsageError):
            wrong()
