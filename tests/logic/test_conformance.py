"""Cases computed by other engines: rtamt (robustness) and mstlo (intervals)."""

import json
from collections import Counter
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from avrare.base.errors import FormulaError
from avrare.logic import FormulaMonitor, stl

DATA = Path(__file__).resolve().parent.parent / "data"
UNIT = {"s": Fraction(1), "ms": Fraction(1, 1000), "us": Fraction(1, 10**6)}
CASES = json.loads((DATA / "stl_cases.json").read_text())["cases"]
INTERVALS = json.loads((DATA / "rosi_cases.json").read_text())["cases"]
CHAINED = "p > 0 -> q > 0 -> p > 1"


def numbers(values):
    return np.array(
        [[float(x) for x in value] if isinstance(value, list) else float(value) for value in values]
    )


def signals_of(case):
    return {name: numbers(values) for name, values in case["signals"].items()}


def formula_of(case, until="half-open"):
    return stl(case["formula"], dt=Fraction(case["period"]) * UNIT[case["period_unit"]], until=until)


def check(got, expected):
    np.testing.assert_allclose(got, numbers(expected), rtol=0, atol=1e-9)


def online_prefixes(formula, signals):
    monitor = FormulaMonitor(formula)
    state, values = monitor.start(1), []
    for t in range(len(next(iter(signals.values())))):
        state, verdict = monitor.update(state, {name: x[t : t + 1] for name, x in signals.items()})
        values.append(verdict.robustness[0])
    return np.array(values)


def by_id(cases):
    return pytest.mark.parametrize("case", cases, ids=[case["id"] for case in cases])


def test_the_cases_are_complete():
    tiers = Counter(case["tier"] for case in CASES)
    assert tiers == {
        "nested": 55, "basic": 30, "hard": 30, "syntax": 21, "past": 10, "future": 10, "step": 6, "units": 4,
        "workload": 2,
    }  # fmt: skip
    assert len(INTERVALS) == 60


@by_id([case for case in CASES if case["formula"] != CHAINED])
def test_robustness_agrees_with_rtamt(case):
    formula, signals = formula_of(case), signals_of(case)
    check(formula.robustness(signals), case["expected"])
    if "expected_prefix0" in case:
        check(formula.prefixes(signals), case["expected_prefix0"])
        check(online_prefixes(formula, signals), case["expected_prefix0"])
    if "horizon" in case:
        assert formula.horizon == float(case["horizon"])


@by_id([case for case in CASES if "expected_closed" in case])
def test_closed_until_agrees_with_the_definitions(case):
    formula, signals = formula_of(case, "closed"), signals_of(case)
    check(formula.robustness(signals), case["expected_closed"])
    check(formula.prefixes(signals), case["expected_closed_prefix0"])
    check(online_prefixes(formula, signals), case["expected_closed_prefix0"])


@by_id([case for case in CASES if "rtamt_parse" in case and case["formula"] != CHAINED])
def test_texts_are_parsed_like_rtamt(case):
    period = Fraction(case["period"]) * UNIT[case["period_unit"]]
    words = case["rtamt_parse"].replace("s_previous", "s_prev").replace("previous", "prev")
    for fraction in ("1/10", "2/5"):
        words = words.replace(fraction, str(float(Fraction(fraction))))
    assert stl(words, dt=period).node == formula_of(case).node


def test_chained_implications_are_refused():
    assert any(case["formula"] == CHAINED for case in CASES)
    with pytest.raises(FormulaError, match="does not chain"):
        stl(CHAINED)


@by_id(INTERVALS)
def test_intervals_agree_with_mstlo(case):
    signals = signals_of(case)
    assert case["horizon"] < case["n"]
    check(stl(case["formula"]).intervals(signals), case["rosi_t0"])
    check(stl(case["formula"]).intervals(signals, length=case["n"]), case["rosi_t0"])
