"""Shapes, quantifiers, infinities, and errors of the offline evaluation."""

import math
import subprocess
import sys

import numpy as np
import pytest

from avrare.base.errors import FormulaError
from avrare.logic import stl

INF = math.inf


def random_walks(seed, *shape):
    return np.cumsum(np.random.default_rng(seed).normal(size=shape), axis=1)


def test_shapes_follow_the_signals():
    formula, batch = stl("always[0,3] (p > 0)"), {"p": random_walks(0, 4, 9)}
    one = {"p": batch["p"][2]}
    for method in (formula.robustness, formula.prefixes, formula.satisfied):
        assert method(batch).shape == (4, 9)
        assert np.array_equal(method(one), method(batch)[2])
    assert formula.intervals(batch).shape == (4, 9, 2)
    assert np.array_equal(formula.intervals(one), formula.intervals(batch)[2])
    assert formula.robustness({"p": np.empty((0, 5))}).shape == (0, 5)


@pytest.mark.parametrize(
    "text", ["exp(p) - log(abs(p) + 1) > pow(abs(q), 0.3)", "F[0,3] (sqrt(abs(p)) / q > 0.1) and O G q"]
)
def test_rows_do_not_depend_on_their_neighbours(text):
    formula = stl(text)
    signals = {"p": random_walks(1, 33, 12), "q": random_walks(2, 33, 12)}
    for method in (formula.robustness, formula.prefixes, formula.satisfied, formula.intervals):
        together = method(signals)
        alone = [method({name: x[i : i + 1] for name, x in signals.items()})[0] for i in range(33)]
        assert np.array_equal(together, np.stack(alone))


def test_inputs_are_not_modified():
    signals = {"p": random_walks(3, 5, 9), "q": random_walks(4, 5, 9)}
    before = {name: x.copy() for name, x in signals.items()}
    for text in ("p", "once p", "p until[1,3] q", "always[0,2] p -> q"):
        for method in (stl(text).robustness, stl(text).prefixes, stl(text).intervals):
            method(signals)[...] = 7.0
    assert all(np.array_equal(signals[name], before[name]) for name in before)


def test_infinite_signals_have_margins():
    signals = {"p": np.array([INF, -INF, 0.0]), "q": np.array([INF, INF, INF])}
    assert list(stl("p < 4").robustness(signals)) == [-INF, INF, 4]
    assert list(stl("p < q").robustness(signals)) == [0, INF, INF]
    assert list(stl("p iff q").robustness(signals)) == [0, -INF, -INF]
    assert list(stl("p < q").satisfied(signals)) == [False, True, True]


def test_arithmetic():
    signals = {"p": np.array([1.0, 4.0]), "q": np.array([-2.0, 3.0])}
    assert list(stl("p + 2 * q / 4 - 1 > -q").robustness(signals)) == [-3.0, 7.5]
    assert list(stl("max(abs(q), sqrt(p), pow(p, 2))").robustness(signals)) == [2.0, 16.0]
    np.testing.assert_allclose(stl("log(exp(min(p, q)))").robustness(signals), [-2.0, 3.0])


def test_quantifiers_reduce_the_last_axis():
    gap, speed = random_walks(5, 4, 9, 3), random_walks(6, 4, 9)
    signals = {"gap": gap, "speed": speed}
    inner = gap + speed[..., None]
    assert np.array_equal(stl("forall o in others: gap + speed").robustness(signals), inner.min(axis=2))
    assert np.array_equal(stl("exists o in others: gap + speed").robustness(signals), inner.max(axis=2))
    outside, inside = stl("forall o in others: always gap"), stl("always (forall o in others: gap)")
    for method in ("robustness", "prefixes", "satisfied", "intervals"):
        assert np.array_equal(getattr(outside, method)(signals), getattr(inside, method)(signals))
    mixed = stl("exists o in others: (gap > 0) until[0,4] (gap + speed > 1)")
    alone = stl("(g > 0) until[0,4] (g + speed > 1)")
    alone = [alone.robustness({"g": gap[..., v], "speed": speed}) for v in range(3)]
    assert np.array_equal(mixed.robustness(signals), np.max(alone, axis=0))
    nobody = {"gap": np.empty((2, 5, 0))}
    assert (stl("forall o in others: gap").robustness(nobody) == INF).all()
    assert not stl("exists o in others: gap").satisfied(nobody).any()


def test_intervals_use_known_values_of_terms():
    p = {"p": np.array([0.5, 1.0])}
    assert stl("eventually[0,3] (abs(p) < 1.5)").intervals(p).tolist() == [[1.0, 1.5], [1.0, 1.5]]
    assert stl("always[0,3] (min(p, 2) - 1 < 4)").intervals(p).tolist() == [[3.0, 4.5], [3.0, 4.0]]
    assert stl("always (p < 4)").intervals(p).tolist() == [[-INF, 3.5], [-INF, 3.0]]
    assert stl("always (p < 4)").intervals(p, length=2).tolist() == [[-INF, 3.5], [3.0, 3.0]]
    assert stl("eventually[4,6] p").intervals(p, length=3).tolist() == [[-INF, -INF]] * 2


GOOD = np.zeros((2, 3))


@pytest.mark.parametrize(
    ("text", "signals", "message"),
    [
        ("speed > 0", {"sped": GOOD}, "'speed' is missing"),
        ("p", {"p": [1.0, 2.0]}, "must be a NumPy array"),
        ("p", {"p": np.array(1.0)}, "single number"),
        ("p", {"p": np.array(["a"])}, "not real numbers"),
        ("p", GOOD, "must be a mapping"),
        ("p and q", {"p": GOOD, "q": np.zeros((2, 4))}, "different shapes"),
        ("p", {"p": np.zeros((2, 0))}, "no samples"),
        ("p", {"p": np.array([1.0, np.nan])}, "NaN at index"),
        ("p", {"p": np.zeros((2, 3, 4))}, "trailing axis"),
        ("p", {"p": np.zeros((2, 3, 1))}, r"has the shape \(N,\), not \(N, 1\)"),
        ("forall o in others: p", {"p": GOOD}, "depends on o"),
        ("log(p - 1) > 0", {"p": GOOD}, "no value"),
        ("forall o in o: p and q", {"p": np.zeros((2, 3, 4)), "q": np.zeros((2, 3, 5))}, "be combined"),
        ("true", {}, "no signals"),
    ],
)
def test_unfit_signals_are_refused(text, signals, message):
    formula = stl(text)
    for method in (formula.robustness, formula.prefixes, formula.satisfied, formula.intervals):
        with pytest.raises(FormulaError, match=message):
            method(signals)


def test_unused_signals_and_other_number_types_are_accepted():
    signals = {"p": np.array([True, False]), "n": np.array([3, -1]), "junk": "ignored"}
    assert list(stl("p and n > 1").robustness(signals)) == [1.0, -2.0]
    assert list(stl("not p").satisfied(signals)) == [False, True]


def test_constants_take_their_shape_from_any_signal():
    assert stl("always true").robustness({"p": GOOD}).tolist() == np.full((2, 3), INF).tolist()
    assert not stl("1 > 2").satisfied({"p": GOOD}).any()


@pytest.mark.parametrize(
    "first", ["import avrare", "import avrare.logic.formula, avrare", "import avrare; avrare.Problem"]
)
def test_the_public_name_is_callable_whatever_was_imported_first(first):
    code = f"{first}; assert avrare.stl('always (x < 4)', until='half-open').signals == ('x',)"
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.parametrize("quantifier", ["forall", "exists", "at_least 1", "at_least 2", "not at_least 3"])
def test_a_member_without_a_value_is_an_error(quantifier):
    formula = stl(f"{quantifier} o in others: (sqrt(d(o, ego)) > 1)")
    trace = {"d(others, ego)": np.array([[[-1.0, 4.0, 0.25]]])}
    with pytest.raises(FormulaError, match="no value"), np.errstate(invalid="ignore"):
        formula.robustness(trace)
