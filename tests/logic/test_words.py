"""Formulas in English."""

import pytest

from avrare.logic.formula import stl
from avrare.logic.syntax.printer import to_words

WORDS = {
    "always (x < 4)": "At all times, x is below 4.",
    "eventually[0,2] (x >= 1)": "At some time within 2 s, x is at least 1.",
    "always[1,3] not (x == 2)": "At all times between 1 and 3 s, it is not so that x equals 2.",
    "always ((x > 1) -> eventually[0,1] (y < 0))": "At all times, if x is above 1, "
    "then (at some time within 1 s, y is below 0).",
    "(x > 1) until[0,2] (y < 0)": "x is above 1, until (within 2 s) y is below 0.",
    "x - y": "x - y is above 0.",
    "once[2,inf] (x > 1)": "At some time 2 s or more ago, x is above 1.",
    "historically[0,2] (x > 1)": "At all times of the last 2 s, x is above 1.",
    "once[1,1] (x > 1)": "1 s before, x is above 1.",
    "eventually[2,2] (x > 1)": "2 s later, x is above 1.",
    "always (a > 1)": "At all times, a is above 1.",
    "(a > 1) -> (i > 1)": "If a is above 1, then i is above 1.",
    "abs(x) < 4": "abs(x) is below 4.",
    "prev (x > 1)": "One step before, x is above 1.",
    "(x > 1) iff (y > 1)": "x is above 1 exactly if y is above 1.",
    "forall o in others: always (gap(o) > 2)": "For each o of others, at all times, gap(o) is above 2.",
}


@pytest.mark.parametrize(("formula", "words"), WORDS.items())
def test_formulas_in_words(formula, words):
    made = stl(formula, dt=0.5, warn=False)
    assert to_words(made.node, float(made.dt)) == words
