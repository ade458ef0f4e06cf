"""A row that breaks down is an error: no failure, no pass, and no concern of its neighbours."""

import numpy as np
import pytest

import avrare
import odd_systems
from avrare.base.errors import UsageError
from avrare.rollout.noise import NoiseSource
from avrare.testing import faulty_systems as systems
from rollout_requests import fresh

STEPS = 30
ROWS = 300
NOISE = NoiseSource(2, 2)
HOWS = ("nan", "fault", "raise")


def problem(system, formula="always (x < 0.8)"):
    return avrare.Problem(system, avrare.stl(formula), steps=STEPS)


def simulate(system, rows=ROWS, **keywords):
    return problem(system, **keywords).simulate(NOISE, fresh(rows))


@pytest.fixture(scope="module")
def healthy():
    return simulate(systems.Fragile("never"))


def breakdowns():
    bad = NOISE.normals(0, 0, np.arange(ROWS)[:, None], np.arange(STEPS + 1))[:, :, 1] > 2.5
    bad[:, 0] = False
    return bad


@pytest.mark.parametrize("how", HOWS)
def test_only_rows_that_break_down_are_errors(how, healthy):
    expected = breakdowns().any(axis=1)
    outcome = simulate(systems.Fragile(how))
    assert 20 < expected.sum() < 200
    np.testing.assert_array_equal(outcome.error, expected)
    assert not outcome.violated[expected].any()
    for name in ("violated", "robustness", "scores"):
        np.testing.assert_array_equal(getattr(outcome, name)[~expected], getattr(healthy, name)[~expected])
    assert healthy.violated[expected].any(), "some rows would have failed had they not broken down"


@pytest.mark.parametrize("how", HOWS)
def test_an_errored_row_keeps_its_last_score(how, healthy):
    outcome, bad = simulate(systems.Fragile(how)), breakdowns()
    for row in np.flatnonzero(outcome.error):
        at = int(bad[row].argmax())
        np.testing.assert_array_equal(outcome.scores[row, :at], healthy.scores[row, :at])
        np.testing.assert_array_equal(outcome.scores[row, at:], healthy.scores[row, at - 1])
        assert outcome.robustness[row, 0] == -healthy.scores[row, at - 1]


@pytest.mark.parametrize("how", HOWS)
def test_errors_at_the_start(how):
    outcome = simulate(systems.Fragile(how, beyond=1.0, at_start=True))
    expected = NOISE.normals(0, 0, np.arange(ROWS), 0)[:, 1] > 1.0
    np.testing.assert_array_equal(outcome.error, expected)
    assert np.isneginf(outcome.scores[expected]).all()
    assert outcome.simulated_steps == (~expected).sum() * STEPS


def test_only_rows_without_errors_are_stepped():
    """Pass the rows that raised never again, after the bisection at step 1."""

    class Early(systems.Walk):
        def step(self, state, noise):
            if (state["x"] == 0.0).any() and (noise[:, 0] > 2.0).any():
                raise RuntimeError("early")
            return super().step(state, noise)

    system = systems.Counting(Early())
    task = avrare.Problem(system, avrare.stl("always (x < 9)"), steps=3)
    outcome = task.simulate(NoiseSource(0, 1), fresh(64))
    good = (~outcome.error).sum()
    assert 0 < outcome.error.sum() < 10
    assert outcome.simulated_steps == system.rows
    assert system.rows > 64 + 2 * good, "what the bisection repeats is paid for"


def test_infinity_is_a_value():
    class Far(systems.Walk):
        def step(self, state, noise):
            return {"x": np.where(noise[:, 0] > 0, np.inf, -np.inf)}

    task = avrare.Problem(Far(), avrare.stl("always (x < 4)"), steps=1)
    tape = np.array([[[0.0], [1.0]], [[0.0], [-1.0]]])
    outcome = task.replay(tape)
    assert not outcome.error.any()
    assert outcome.violated[:, 0].tolist() == [True, False]
    assert task.robustness(tape).tolist() == [-np.inf, 4.0]


def test_a_formula_without_a_value_is_an_error_and_no_pass():
    task = avrare.Problem(odd_systems.Infinite(), avrare.stl("always (x - y < 4)"), steps=2)
    tape = np.zeros((3, 3, 1))
    tape[:, 0, 0] = -1.0, 0.5, 2.0  # 0 - 0, inf - 0, inf - inf
    outcome = task.replay(tape)
    assert outcome.error.tolist() == [False, False, True]
    assert outcome.violated[:, 0].tolist() == [False, True, False]
    assert "no value" in outcome.messages[0]
    assert outcome.simulated_steps == 2 * 2, "the third row has left the batch"
    assert np.isnan(task.robustness(tape)[2])


def test_nan_in_a_signal_that_no_formula_reads():
    class Chatty(systems.Walk):
        def signals(self, state):
            return {"x": state["x"], "aside": np.where(state["x"] > 0.5, np.nan, 0.0)}

    outcome = problem(Chatty(), "always (x < 9)").simulate(NoiseSource(2, 1), fresh(100))
    assert 0 < outcome.error.sum() < 100


def test_robustness_of_an_errored_row_is_nan():
    tape = np.zeros((2, STEPS + 1, 2))
    tape[1, 4, 1] = 9.0
    np.testing.assert_array_equal(problem(systems.Fragile("raise")).robustness(tape), [0.8, np.nan])


class Manifold(systems.Walk):
    """Rows break down in several ways, some of them in the same step."""

    def step(self, state, noise):
        if (noise[:, 0] > 2.2).any():
            raise RuntimeError("lost its way")
        return super().step(state, noise) | {"u": noise[:, 0]}

    def initial(self, noise):
        return super().initial(noise) | {"u": noise[:, 0]}

    def signals(self, state):
        u = state["u"]
        high, low = np.where(u > 1.8, np.nan, u), np.where(u < -1.8, np.nan, u)
        return {**super().signals(state), "high": high, "low": low}

    def faults(self, state):
        return np.abs(state["u"]) < 0.005


@pytest.mark.parametrize("chunk", [1, 7, 50])
def test_messages_do_not_depend_on_the_chunk(chunk):
    def messages(chunk):
        made = avrare.Problem(Manifold(), avrare.stl("always (x < 9)"), steps=STEPS, chunk=chunk)
        return avrare.estimate(made, "mc", rollouts=ROWS, seed=2).health["errors"]

    assert messages(chunk) == messages(ROWS)


def test_messages_tell_of_each_way_by_the_first_row_that_went_it():
    assert sorted(simulate(Manifold()).messages) == [
        "NaN in signal high", "NaN in signal low", "RuntimeError: lost its way",
        "fault reported by the system",
    ]  # fmt: skip


def test_avrare_errors_are_not_swallowed():
    class Wrong(systems.Walk):
        def step(self, state, noise):
            raise UsageError("a wrong argument")

    with pytest.raises(UsageError, match="a wrong argument"):
        avrare.estimate(problem(Wrong()), rollouts=3)


def test_want_of_memory_is_no_error_of_a_rollout():
    """Raise it: otherwise the machine would decide which rollouts count."""

    class Hungry(systems.Walk):
        def step(self, state, noise):
            raise MemoryError

    with pytest.raises(MemoryError):
        simulate(Hungry())


def broken(states):
    raise ZeroDivisionError("no wheel")


@pytest.mark.parametrize(
    ("member", "answer", "message"),
    [
        ("ended", broken, r"ended\(state\) raised ZeroDivisionError: no wheel"),
        ("ended", lambda state: False, r"ended\(state\) has shape bool"),
        ("ended", lambda state: np.zeros(3, dtype=bool), r"ended\(state\) has shape \(3,\)"),
        ("counts", broken, r"counts\(state\) raised ZeroDivisionError: no wheel"),
        ("counts", lambda state: {"solves": 3}, "count 'solves' has shape int"),
        ("counts", lambda state: {"solves": np.zeros(ROWS)}, "count 'solves' holds float64"),
    ],
)
def test_an_answer_on_all_rows_that_is_none_says_so(member, answer, message):
    system = systems.Fragile("never")
    setattr(system, member, answer)
    with pytest.raises(UsageError, match=message):
        simulate(system)
