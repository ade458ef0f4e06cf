"""The robustness of sub-formulas, and what decides a formula."""

import math
import warnings

import numpy as np
import pytest

from avrare.base.errors import FormulaError
from avrare.logic import FormulaWarning, stl

INF = math.inf


def test_parts_have_every_distinct_sub_formula_root_first():
    signals = {"p": np.array([[1.0, -2.0, 3.0]]), "q": np.array([[0.0, 1.0, -1.0]])}
    formula = stl("always (p > 0 -> once q > 0) and eventually (p > 0)")
    parts = formula.parts(signals)
    inside = ["always (p > 0 -> once q > 0)", "p > 0 -> once q > 0", "p > 0", "once q > 0", "q > 0"]
    written = [str(stl(text, warn=False)) for text in [*inside, "eventually (p > 0)"]]
    assert list(parts) == [str(formula), *written]
    assert parts["p > 0"].tolist() == [[1, -2, 3]]
    assert parts[written[3]].tolist() == [[0, 1, 1]]
    assert parts[written[5]].tolist() == [[3, 3, 3]]
    assert np.array_equal(parts[str(formula)], formula.robustness(signals))
    one = formula.parts({name: x[0] for name, x in signals.items()})
    assert one["q > 0"].tolist() == [0, 1, -1]


def test_parts_below_a_quantifier_keep_the_vehicles():
    gap = np.random.default_rng(0).normal(size=(4, 6, 3))
    parts = stl("forall o in others: always (gap(o, ego) > 0)").parts({"gap(others, ego)": gap})
    assert [x.shape for x in parts.values()] == [(4, 6), (4, 6, 3), (4, 6, 3)]
    assert np.array_equal(parts["gap(o, ego) > 0"], gap)


RULE = "forall o in others: always (in_front_of(o, ego) > 0 -> keeps_safe_distance(ego, o) > 0)"
DISTANCE = np.full((6, 3), 2.0)
DISTANCE[3, 1] = -0.12
DISTANCE[5, 2] = -0.5
TRAFFIC = {"in_front_of(others, ego)": np.ones((6, 3)), "keeps_safe_distance(ego, others)": DISTANCE}


@pytest.mark.parametrize("lead", [0, 1])
def test_a_broken_rule_names_sample_vehicle_and_predicate(lead):
    signals = {name: x[None] if lead else x for name, x in TRAFFIC.items()}
    why = stl(RULE).explain(signals, {"others": ["slow", "cut_in", "truck"]})
    assert (why.robustness, why.violated, why.first, why.worst) == (-0.5, True, 3, 5)
    assert (why.bindings, why.formula, why.value) == (
        {"o": "truck"}, "keeps_safe_distance(ego, truck) > 0", -0.5,
    )  # fmt: skip
    assert why.earliest.bindings == {"o": "cut_in"}
    last = why.earliest.chain[-1]
    assert (last.text, last.sample, last.value) == ("keeps_safe_distance(ego, cut_in) > 0", 3, -0.12)
    assert [link.sample for link in why.chain] == [0, 0, 5, 5]
    assert [link.value for link in why.chain] == [-0.5] * 4
    unnamed = stl(RULE).explain(signals)
    assert unnamed.bindings == {"o": 2}
    assert unnamed.formula == "keeps_safe_distance(ego, others[2]) > 0"


def test_a_kept_rule_is_explained_by_its_tightest_sample():
    signals = TRAFFIC | {"keeps_safe_distance(ego, others)": np.abs(DISTANCE)}
    why = stl(RULE).explain(signals)
    assert (why.robustness, why.violated, why.worst, why.bindings) == (0.12, False, 3, {"o": 1})


def decided(text, members=None, until="closed", **signals):
    arrays = {name: np.array(x, dtype=float) for name, x in signals.items()}
    formula = stl(text, until=until, warn=False)
    why = formula.explain(arrays, members)
    values = formula.robustness({name: x[None] for name, x in arrays.items()})
    assert why.robustness == values[0, 0] == why.chain[0].value
    assert why.violated == (not formula.satisfied({name: x[None] for name, x in arrays.items()})[0, 0])
    return why.formula, why.chain[-1].sample, why.first


def test_each_operator_leads_to_its_deciding_part():
    p, q = [1, 2, -1, -3], [-2, -1, -4, -1]
    assert decided("always p", p=p) == ("p", 3, 2)
    assert decided("eventually (p > 3)", p=p) == ("p > 3", 1, 1)
    assert decided("not (eventually (p > 0))", p=p) == ("p > 0", 1, 0)
    assert decided("always (p > 0 or q > 0)", p=p, q=q) == ("p > 0", 2, 2)
    assert decided("always (p > -9 and q > -9)", p=p, q=q) == ("q > -9", 2, 2)
    assert decided("always (p > 0 -> q > 0)", p=p, q=q) == ("p > 0", 0, 0)
    assert decided("next (next p)", p=p) == ("p", 2, 1)
    assert decided("always[9,10] p", p=p) == ("always[9:10 samples] p", 0, 0)
    assert decided("always (once[1,1] p or p)", p=p) == ("p", 2, 3)
    assert decided("always (fall(p) -> q > 0)", p=p, q=[1, 1, -0.5, 1])[0] == "q > 0"


def test_a_broken_until_names_the_operand_that_fails():
    assert decided("p until q", p=[1, 1, -1, 1], q=[-2, -2, -2, 5]) == ("p", 2, 2)
    assert decided("p until q", p=[1, 1, 1, 1], q=[-2, -1, -3, -4]) == ("q", 1, 1)
    assert decided("p until q", p=[1, 1, -3, 1], q=[-2, -1, -3, 1]) == ("q", 1, 1)
    assert decided("p until[2,3] q", p=[1, -1, 1, 1], q=[5, 5, 5, 5]) == ("p", 1, 1)
    assert decided("p until q", p=[1, 1, -1], q=[-5, -5, 2]) == ("p", 2, 2)
    assert decided("p until q", until="half-open", p=[1, 1, -1], q=[-5, -5, 2]) == ("p", 0, 0)
    assert decided("p unless q", p=[1, -1, 1], q=[-2, -5, 3]) == ("p", 1, 1)


def test_counting_quantifiers_name_the_vehicle_that_is_missing():
    near = np.array([[3.0, -1.0, -2.0]])
    why = stl("at_least 2 o in others: near(o, ego) > 0").explain({"near(others, ego)": near})
    assert (why.violated, why.bindings, why.value) == (True, {"o": 1}, -1.0)
    why = stl("exists o in others: near(o, ego) > 3").explain({"near(others, ego)": near})
    assert (why.violated, why.bindings, why.value) == (True, {"o": 0}, 0.0)
    why = stl("at_least 4 o in others: near(o, ego) > 0").explain({"near(others, ego)": near})
    assert (why.violated, why.robustness, why.bindings) == (True, -INF, {})


def test_nested_quantifiers_bind_one_vehicle_each():
    pairs = np.full((2, 2, 2), 5.0)
    pairs[1, 0, 1] = -1.0
    text = "always (forall a in others: forall b in others: ahead(b, a) > 0)"
    why = stl(text).explain({"ahead(others, others)": pairs}, {"others": ["x", "y"]})
    assert (why.bindings, why.formula, why.worst) == ({"a": "y", "b": "x"}, "ahead(x, y) > 0", 1)


def test_truth_under_iff_is_exact():
    assert decided("always (p iff q)", p=[1, 0], q=[1, 0]) == ("p", 0, 0)
    signals = {"p": np.array([1.0, 2.0]), "q": np.array([3.0, -1.0])}
    why = stl("always (p > 0 xor q > 0)", warn=False).explain(signals)
    assert (why.violated, why.first, why.robustness) == (True, 0, 2.0)


def test_several_traces_are_refused():
    with pytest.raises(FormulaError, match="one trace"):
        stl("always p").explain({"p": np.zeros((2, 3))})


def test_formula_warnings_are_issued_and_kept():
    with pytest.warns(FormulaWarning, match="iff"):
        formula = stl("p iff q")
    assert len(formula.warnings) == 1
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert stl("p iff q", warn=False).warnings == formula.warnings
        assert stl("always (p > 0)").warnings == ()


def verdicts(text, x, length=None):
    monitor = stl(text).interval_monitor(length)
    state, out = monitor.start(1), []
    for value in x:
        state, verdict = monitor.update(state, {"x": np.array([float(value)])})
        out.append((verdict.lower[0], verdict.upper[0], bool(verdict.decided[0]), bool(verdict.violated[0])))
    return out


def test_interval_verdicts_come_as_early_as_they_can():
    assert verdicts("always (x < 4)", [3, 4]) == [(-INF, 1, False, False), (-INF, 0, True, True)]
    assert verdicts("always (x <= 4)", [4, 5]) == [(-INF, 0, False, False), (-INF, -1, True, True)]
    assert verdicts("eventually (x >= 4)", [3, 4]) == [(-1, INF, False, False), (0, INF, True, False)]
    assert verdicts("always[0,1] (x < 4)", [3, 2, 9])[1:] == [(1, 1, True, False)] * 2
    assert verdicts("always (x < 4)", [3, 2], length=2)[1] == (1, 1, True, False)
    assert verdicts("eventually[5,6] (x > 0)", [1], length=3) == [(-INF, -INF, True, True)]
    assert verdicts("always (x > 0 -> eventually[0,1] (x < 0))", [1, 1])[1] == (-INF, -1, True, True)
    assert verdicts("always ((x < 4) iff (x < 5))", [4]) == [(-INF, -1, True, True)]


def test_nan_rows_are_never_decided():
    monitor = stl("always ((x > 0) and not (x > 9 xor x > 8))", warn=False).interval_monitor(2)
    state, verdict = monitor.update(monitor.start(2), {"x": np.array([math.nan, 1.0])})
    _, verdict = monitor.update(state, {"x": np.array([1.0, 1.0])})
    assert list(verdict.decided) == [False, True]
