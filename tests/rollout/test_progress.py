"""The score of formulas that may still come true: 1 exactly where violated, and good enough to split on."""

import numpy as np
import pytest

import avrare
from avrare.base import batch
from avrare.base.errors import UsageError
from avrare.logic import FormulaMonitor
from avrare.rollout.noise import NoiseSource
from avrare.rollout.problem import Problem
from avrare.rollout.request import Request
from avrare.rollout.scores.progress_score import ProgressScored, shape_of
from avrare.testing.faulty_systems import Walk

PENDING = [
    "eventually[0:6] (x > 1)",
    "eventually (x > 1.5)",
    "not (always[2:9] (x < 1))",
    "always[0:8] (x > 0 -> eventually[0:4] (y > 0.5))",
    "always (x > 0.5 -> eventually y > 0)",
    "eventually always[0:2] (x > 0)",
    "always[1:6] (eventually[0:2] (x > 0) and next (y > -2))",
    "(x > -1) until[0:8] (y > 0.8)",
    "x > -0.5 or eventually[3:7] (once[0:2] (y > 1))",
    "(always[0:5] x > -2) and eventually[0:9] (y >= 0.7)",
    "eventually[4:40] (x > 1)",
]
STEPS = 11


def walks(seed, rows):
    steps = np.random.default_rng(seed).normal(scale=0.5, size=(2, rows, STEPS + 1))
    return dict(zip("xy", np.cumsum(steps, axis=2), strict=True))


def scored(text, **keywords):
    monitor = FormulaMonitor(avrare.stl(text))
    shape = shape_of(monitor.formula)
    assert shape is not None
    return ProgressScored(monitor, shape, STEPS, **keywords)


def course(spec, signals):
    """Return (N, T) score and (N, T) violated of every prefix."""
    state = spec.start(len(signals["x"]))
    scores, violated = [], []
    for t in range(STEPS + 1):
        state, verdict = spec.update(state, {name: x[:, t] for name, x in signals.items()})
        scores.append(verdict.score)
        violated.append(verdict.violated)
    return np.stack(scores, axis=1), np.stack(violated, axis=1)


@pytest.mark.parametrize("text", PENDING)
def test_the_score_is_one_exactly_where_the_rollout_fails(text):
    signals = walks(1, 400)
    scores, violated = course(scored(text), signals)
    assert np.array_equal(scores[:, -1] == 1.0, violated[:, -1])
    assert 0 < violated[:, -1].sum() < 400
    assert (np.diff(scores, axis=1) >= 0).all()
    assert ((scores >= 0) & (scores <= 1)).all()


def test_the_score_of_eventually_rises_with_time_and_with_distance():
    signals = {"x": np.array([[0.0] * 12, [0.5] * 12, [0.0] * 5 + [2.0] * 7])}
    scores, _ = course(scored("eventually[0:8] (x > 1)"), {**signals, "y": signals["x"]})
    assert (np.diff(scores[0, :9]) > 0).all()
    assert (scores[0, :8] > scores[1, :8]).all()
    assert scores[0, 8] < 1.0 <= scores[0, 11]
    assert scores[2, 11] == scores[2, 4] < scores[0, 5]


def test_a_copied_state_continues_identically():
    signals, index = walks(2, 30), np.array([3, 3, 29, 0])
    spec = scored("always[0:8] (x > 0 -> eventually[0:4] (y > 0.5))")
    state = spec.start(30)
    for t in range(6):
        state, _ = spec.update(state, {name: x[:, t] for name, x in signals.items()})
    part = batch.take(state, index)
    for t in range(6, STEPS + 1):
        state, whole = spec.update(state, {name: x[:, t] for name, x in signals.items()})
        part, verdict = spec.update(part, {name: x[index, t] for name, x in signals.items()})
        assert np.array_equal(verdict.score, whole.score[index])


def test_parts_are_weighted_by_their_noise_free_sizes():
    signals = {"x": np.full((1, 12), 10.0), "y": np.full((1, 12), 0.1)}
    nominal = [{"x": np.array([10.0]), "y": np.array([0.1])}] * 12
    text = "(always[0:5] x > 0) and (always[0:5] y > 0) and eventually[0:9] (x > 0)"
    plain, _ = course(scored(text), signals)
    weighed, _ = course(scored(text, nominal=nominal), signals)
    assert plain[0, -1] == pytest.approx(1 - 0.99 * 0.1)
    assert weighed[0, -1] == pytest.approx(0.01)


LASTING = ["always (x > 0)", "x > 1", "always once (x > 0)", "not eventually (x > 3)"]


@pytest.mark.parametrize("text", [*LASTING, "always[2:5] (x > 0) iff eventually (x > 1)"])
def test_formulas_that_cannot_come_true_later_have_no_repeated_shape(text):
    shape = shape_of(avrare.stl(text))
    assert shape is None or not shape.repeated


REACH = Walk(drift=0.1, scale=0.2)


class Pull(Walk):
    """x = 0.9 x + sqrt(0.19) w, from 0.5."""

    def initial(self, noise):
        return {"x": np.full(len(noise), 0.5)}

    def step(self, state, noise):
        return {"x": 0.9 * state["x"] + np.sqrt(0.19) * noise[:, 0]}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("system", "text", "steps", "probability"),
    [
        (REACH, "eventually[1:40] (x >= 0.5)", 40, 8.4429247212e-4),
        (Pull(), "always[0:60] ((x >= 2) -> eventually[0:40] (x <= 0))", 100, 0.0216815373671),
    ],
    ids=["reach", "response"],
)
def test_splitting_on_the_default_score_is_unbiased_without_extinct_runs(system, text, steps, probability):
    problem = Problem(system, avrare.stl(text), steps)
    result = avrare.estimate(problem, "ams", particles=60, discard=6, runs=30, seed=4)
    error = result.run_probabilities.std(ddof=1) / np.sqrt(30)
    assert abs(result.probability - probability) < 4 * error < probability
    assert result.diagnostics["extinct_runs"] == 0


def test_progress_by_name_needs_a_suitable_formula():
    with pytest.raises(UsageError, match="'progress' does not fit"):
        Problem(REACH, avrare.stl("always (x < 4)"), 5, "progress").specifications  # noqa: B018
    named = Problem(REACH, avrare.stl("eventually (x > 4)"), 5, "progress")
    assert isinstance(named.specifications[0], ProgressScored)
    assert isinstance(Problem(REACH, avrare.stl("eventually (x > 4)"), 5).specifications[0], ProgressScored)
    plain = Problem(REACH, avrare.stl("eventually (x > 4)"), 5, "robustness").specifications[0]
    assert isinstance(plain, FormulaMonitor)


def test_a_part_that_holds_with_its_usual_margin_does_not_mask_the_clock_by_default():
    problem = Problem(REACH, avrare.stl("(x < 100) until (x > 90)"), 5)
    scores = problem.simulate(NoiseSource(0, 1), Request.replay(np.zeros((1, 6, 1)))).scores[0]
    assert (np.diff(scores) > 0).all()
    assert scores[-1] == 1.0
