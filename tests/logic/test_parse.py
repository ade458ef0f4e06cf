"""Reading formulas: operators, precedence, bounds, names, errors that point at the place; and in English."""

import math
import subprocess
import sys
from fractions import Fraction

import pytest

from avrare.base.errors import FormulaError
from avrare.logic import stl
from avrare.logic.syntax import parser
from avrare.logic.syntax.printer import to_words


def same(left, right, dt=1.0):
    assert stl(left, dt=dt).node == stl(right, dt=dt).node, (left, str(stl(left, dt=dt)))


@pytest.mark.parametrize(
    ("symbols", "words"),
    [
        ("G p", "always p"),
        ("F p", "eventually p"),
        ("H p", "historically p"),
        ("O p", "once p"),
        ("X p", "next p"),
        ("Y p", "prev p"),
        ("sX p", "s_next p"),
        ("sY p", "s_prev p"),
        ("p U q", "p until q"),
        ("p S q", "p since q"),
        ("p W q", "p unless q"),
        ("[] p", "globally p"),
        ("<>[0,2] p", "finally[0,2] p"),
        ("!p", "not p"),
        ("~p", "not p"),
        ("p & q", "p and q"),
        ("p && q", "p and q"),
        ("p | q", "p or q"),
        ("p || q", "p or q"),
        ("p -> q", "p implies q"),
        ("p <-> q", "p iff q"),
        ("p !== 1", "p != 1"),
        ("ln(p) > 1", "log(p) > 1"),
        ("p;", "p"),
        ("G[0,3] F[1,2] p", "always[0,3] (eventually[1,2] p)"),
        ("X(p) U[0:2] Y(q)", "(next p) until[0,2] (prev q)"),
    ],
)
def test_symbols_and_words(symbols, words):
    same(symbols, words)


@pytest.mark.parametrize(
    ("text", "reading"),
    [
        ("always[0,3] p and q", "(always[0,3] p) and q"),
        ("not p until q", "(not p) until q"),
        ("p and q until r", "p and (q until r)"),
        ("p until q unless r since p", "((p until q) unless r) since p"),
        ("p since q until r", "p since (q until r)"),
        ("p or q and r", "p or (q and r)"),
        ("p -> q or r", "p -> (q or r)"),
        ("p iff q -> r", "p iff (q -> r)"),
        ("p xor q iff r", "p xor (q iff r)"),
        ("p until q until r", "(p until q) until r"),
        ("p iff q iff r", "(p iff q) iff r"),
        ("not p > 0", "not (p > 0)"),
        ("always p > 0", "always (p > 0)"),
        ("p - q - 1 > 0", "((p - q) - 1) > 0"),
        ("p + q * r > 0", "(p + (q * r)) > 0"),
        ("-p * q > 0", "(-(p)) * q > 0"),
        ("p / q / r > 0", "((p / q) / r) > 0"),
        ("2 * -p < - -q", "2 * (-(p)) < -(-(q))"),
        ("once[1,2] p + q", "once[1,2] (p + q)"),
        ("forall o in others: p -> q", "forall o in others: (p -> q)"),
    ],
)
def test_precedence(text, reading):
    same(text, reading)


@pytest.mark.parametrize(
    ("text", "names"),
    [
        ("G > 0", ("G",)),
        ("s < 1 and F[0,3] F > 2", ("s", "F")),
        ("U > 0 U U < 3", ("U",)),
        ("(X) - 1 > 0", ("X",)),
        ("H and O", ("H", "O")),
        ("ego.speed - lead.speed > ms", ("ego.speed", "lead.speed", "ms")),
        ("min > max(min, abs)", ("min", "abs")),
        ("in > 0", ("in",)),
        ("always (S until W)", ("S", "W")),
        ("Y S Y", ("Y",)),
        ("others > 1 and samples > 2", ("others", "samples")),
        ("true", ()),
        ("p > q and q > p", ("p", "q")),
        ("forall in in in: in(in) > 0", ("in(in)",)),
    ],
)
def test_names(text, names):
    assert stl(text).signals == names


@pytest.mark.parametrize(
    ("text", "dt", "horizon"),
    [
        ("F[0,0.3] p", 0.1, 3),
        ("F[0.1:0.7] p", 0.1, 7),
        ("F[0:300ms] p", 0.1, 3),
        ("F[0:2000us] p", 0.001, 2),
        ("F[0:3 samples] p", 0.3, 3),
        ("F[1 sample:3s] p", 0.5, 6),
        ("F[100ms,1] p", 0.1, 10),
        ("F[500,1500ms] p", 0.5, 3),
        ("F[0s,1] p", 1, 1),
        ("F[0,1e-1] p", 0.05, 2),
        ("F[2,inf] p", 1, math.inf),
        ("F[0,5ns] p", 1e-9, 5),
        ("F[0,1] p", Fraction(1, 3), 3),
        ("F[1,2] (G[0,3] p and X q)", 1, 5),
        ("once[0,9] F[0,2] p", 1, 2),
        ("p until[1,4] F[0,2] q", 1, 6),
        ("G p", 1, math.inf),
        ("F[0,0] p", 1, 0),
    ],
)
def test_bounds_are_exact(text, dt, horizon):
    formula = stl(text, dt=dt)
    assert formula.horizon == horizon
    assert stl(str(formula), dt=dt).node == formula.node


@pytest.mark.parametrize(
    ("text", "column", "message", "hint"),
    [
        ("0 < p < 3", 7, "comparisons do not chain", "0 < x and x < 3"),
        ("a -> b -> c", 8, "does not chain", "->"),
        ("always[3,1] p", 7, "larger than the second", ""),
        ("always[0.25,1] p", 8, "0.25 s is not", "samples"),
        ("always[0:1.5 samples] p", 10, "whole number of samples", ""),
        ("alway (x < 4)", 7, "'('", "'always'"),
        ("p = 3", 3, "'='", "=="),
        ("(p > 0) + 1 > 2", 2, "expected a number", ""),
        ("always[-1,2] p", 8, "a bound", "[0,3]"),
        ("abs(p, q) > 1", 1, "abs takes 1 argument", ""),
        ("max(p) > 1", 1, "two or more", ""),
        ("1e999 > p", 1, "too large", ""),
        ("always[0,1e30] p", 10, "out of range", "inf"),
        ("F[inf,inf] p", 3, "infinite", ""),
        ("p and\n  q r", (2, 5), "'r'", ""),
        ("forall o others: p", 10, "'in' is expected", ""),
    ],
)
def test_errors_point_at_the_place(text, column, message, hint):
    with pytest.raises(FormulaError) as caught:
        stl(text, dt=1.0)
    line, column = column if isinstance(column, tuple) else (1, column)
    first, shown, mark = caught.value.message.split("\n")
    assert first.startswith(f"line {line}, column {column}: ")
    assert message in first
    assert shown.strip() == text.split("\n")[line - 1].strip()
    assert mark == "  " + " " * (column - 1) + "^"
    assert hint in (caught.value.hint or "")


@pytest.mark.parametrize("dt", [0, -1.0, math.nan, math.inf, "1", True])
def test_a_bad_period_is_refused(dt):
    with pytest.raises(FormulaError, match="dt is"):
        stl("p", dt=dt)


def test_bad_arguments_are_refused():
    with pytest.raises(FormulaError, match="until is 'open'"):
        stl("p", until="open")
    with pytest.raises(FormulaError, match="text, not int"):
        stl(3)


@pytest.mark.parametrize(
    "text", ["not " * 3000 + "p", " and ".join(["p"] * 3000), "p" + " + p" * 300 + " > 0"]
)
def test_deep_nesting_is_an_error_not_a_crash(text):
    with pytest.raises(FormulaError, match="nested more than"):
        stl(text)


def test_the_parser_is_loaded_when_first_used():
    code = "import sys, avrare.logic; before = 'lark' in sys.modules; avrare.logic.stl('p'); "
    code += "assert (before, 'lark' in sys.modules) == (False, True)"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_a_text_is_parsed_once_in_a_process():
    text = "always[0:3s] (parsed_once < 4)"
    before = parser._parse.cache_info().misses
    formulas = [stl(text, dt=0.1), stl(text, dt=0.1, until="half-open"), stl(text, dt=0.1, warn=False)]
    assert parser._parse.cache_info().misses == before + 1
    assert formulas[0].node is formulas[2].node
    assert stl(text, dt=0.5).node != formulas[0].node


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
