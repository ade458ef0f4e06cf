"""Definitions, vehicles, warnings, printing, odd texts, and every example of docs/formulas.md."""

import itertools
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from avrare.base.errors import FormulaError
from avrare.logic import stl
from avrare.logic.syntax import nodes as f
from avrare.logic.syntax.lint import LintWarning
from avrare.logic.syntax.parser import parse, parse_with_warnings
from avrare.logic.syntax.printer import to_text as printed

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "formulas.md").read_text()


def rows(*header):
    """Return the rows of the page's tables with this header, the backticked texts of each cell."""
    found, inside = [], False
    for line in PAGE.splitlines():
        cells = [cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]]
        inside = bool(cells) and (inside or cells == list(header))
        if inside and cells != list(header) and not set(line) <= set("|-"):
            found.append([cell.replace("\\|", "|") for cell in cells])
    assert found
    return found


def code(cell):
    return re.findall(r"`([^`]+)`", cell)


@pytest.mark.parametrize("text", re.findall(r"```stl\n(.*?)```", PAGE, re.DOTALL))
def test_the_page_s_formulas_are_read_without_a_warning(text):
    node, warnings = parse_with_warnings(text)
    assert not warnings
    assert parse(printed(node)) == node


@pytest.mark.parametrize("row", rows("You may write", "It reads as"), ids=str)
def test_the_page_s_readings(row):
    assert parse(code(row[0])[0]) == parse(code(row[1])[0])


@pytest.mark.parametrize("row", rows("Operator", "Also written", "True at a sample if"), ids=str)
def test_the_page_s_spellings(row):
    (name,) = code(row[0])
    assert all(parse(other) == parse(name) for other in code(row[1]))


@pytest.mark.parametrize("row", rows("Refused", "Because"), ids=str)
def test_formulas_that_the_page_calls_refused_are_refused(row):
    with pytest.raises(FormulaError) as caught:
        parse(code(row[0])[0])
    assert row[1] in caught.value.message


@pytest.mark.parametrize("row", rows("Warned", "Because"), ids=str)
def test_formulas_that_the_page_warns_about_give_warnings(row):
    (warning,) = parse_with_warnings(code(row[0])[0])[1]
    assert row[1] in warning.message


def test_the_page_s_quantifiers_and_order_of_binding():
    for cells in rows("Quantifier", "True if the formula holds for", "Robustness"):
        assert isinstance(parse(code(cells[0])[0]), f.Quantifier)
    names = [code(cells[0])[0] for cells in rows("Operator", "Also written", "True at a sample if")]
    infix = [re.fullmatch(r"p (\S+) q", name)[1] for name in names if name.startswith("p ")]
    for tight, loose in itertools.pairwise(infix):
        assert parse(f"p {tight} q {loose} r") == parse(f"(p {tight} q) {loose} r")
        assert parse(f"p {loose} q {tight} r") == parse(f"p {loose} (q {tight} r)")


@pytest.mark.parametrize(
    ("text", "filled_in"),
    [
        ("out = always (p > 0)", "always (p > 0)"),
        ("a = p > 0\nout = always a\n", "always (p > 0)"),
        ("a = p > 0; out = always a;", "always (p > 0)"),
        (";;a = p > 0;\n\n;out = always a;;", "always (p > 0)"),
        ("a = p > 0\nalways\n  (a)\n  and a", "(always (p > 0)) and p > 0"),
        ("gap = front - rear\nalways (2 * gap > 1)", "always (2 * (front - rear) > 1)"),
        ("gap = front - rear\ngap and q", "front - rear and q"),
        ("a = x(c)\nb(o) = a and y(o)\nb(d)", "x(c) and y(d)"),
        ("f(o) = x(o) and prev not x(o)\nforall p in others: f(p)",
         "forall p in others: x(p) and prev not x(p)"),
        ("f(a, b) = x(b, a)\nforall a in others: f(ego, a)", "forall a in others: x(a, ego)"),
        ("n(a) = exists o in others: x(a, o)\nn(car) and n(ego)",
         "(exists o in others: x(car, o)) and (exists o in others: x(ego, o))"),
        ("n(a) = exists o in others: x(a, o)\nforall o in others: n(o)",
         "forall o in others: exists o_2 in others: x(o, o_2)"),
        ("n(a) = exists o in others: x(a, o)\nforall o_2 in others: forall o in others: n(o) and y(o_2)",
         "forall o_2 in others: forall o in others: (exists o_3 in others: x(o, o_3)) and y(o_2)"),
        ("n(a) = exists o in others: x(a, o)\nn(o)", "exists o_2 in others: x(o, o_2)"),
        ("const float c = 2.5\nconst int n = 2\nalways[0:n] (p * n > c)", "always[0,2] (p * 2 > 2.5)"),
        ("const float c = -2.5\np > c", "p > -2.5"),
        ("const int n = 500\nF[0,n ms] p", "F[0,500ms] p"),
        ("const int k = 2\nat_least k o in others: x(o)", "at_least 2 o in others: x(o)"),
        ("k = 3\nonce[k,inf] p", "once[3,inf] p"),
        ("a = G > 0\nF a", "F (G > 0)"),
        ("a = p > 0\nG a", "always (p > 0)"),
        ("a = p > 0\n[]{a}", "always (p > 0)"),
        ("U = p > 0\nq U U", "q until (p > 0)"),
        ("float x\ninput float y; output T z\nx > y // z\n", "x > y"),
        ("specification a\nfrom m.n import T\n@ topic(x, r/x)\nT x\ninput T c\nx.v > 0", "x.v > 0"),
        ("/* a\nfloat b */ x # y\n and // z\r\n q", "x and q"),
        ("float > 0 and const and input", "(float > 0) and const and input"),
        ("a = x\n(a > 1)", "x > 1"),
        ("x > 1\n- y", "x > (1 - y)"),
        ("at_least 2\no in others: x(o)", "at_least 2 o in others: x(o)"),
        ("a.b = p > 0\na.b", "p > 0"),
    ],
)  # fmt: skip
def test_definitions_are_inserted(text, filled_in):
    assert parse(text, dt=0.5) == parse(filled_in, dt=0.5)


@pytest.mark.parametrize(
    ("text", "filled_in"),
    [
        ("p and exists o in others: x(o) or q", "p and (exists o in others: (x(o) or q))"),
        ("p -> forall o in others: x(o) -> q", "p -> (forall o in others: (x(o) -> q))"),
        ("always forall o in others: x(o) and p", "always (forall o in others: (x(o) and p))"),
        ("not exists o in others: x(o)", "not (exists o in others: x(o))"),
        ("p until[0,2] exists o in cars: x(o) since q", "p until[0,2] (exists o in cars: (x(o) since q))"),
        ("(forall o in others: x(o)) and p", "p and q and (forall o in others: x(o))"),
    ],
)
def test_a_quantifier_extends_as_far_right_as_possible(text, filled_in):
    same = parse(text) == parse(filled_in)
    assert same == (not text.startswith("("))


def test_relations_keep_their_axes_in_definitions():
    text = "n(a) = exists b in cars: x(b, a, ego)\nforall c in others: (n(c) or not n(c)) and n(car_1)"
    relations = [part for part in f.walk(parse(text)) if isinstance(part, f.Signal)]
    assert {(each.name, each.axes) for each in relations} == {
        ("x(cars, others, ego)", (1, 0)), ("x(cars, car_1, ego)", (1,)),
    }  # fmt: skip


def test_a_text_with_definitions_evaluates_like_one_without():
    rng = np.random.default_rng(0)
    signals = {name: rng.normal(size=(7, 12, 3)) for name in ("cut(others, ego)", "safe(ego, others)")}
    formula = stl("new(o) = cut(o, ego) and prev not cut(o, ego)\n"
                  "forall o in others: always (new(o) -> once[0,2] (safe(ego, o)))")  # fmt: skip
    plain = stl("forall o in others: always "
                "((cut(o, ego) and prev not cut(o, ego)) -> once[0,2] (safe(ego, o)))")  # fmt: skip
    together = formula.robustness(signals)
    assert np.array_equal(together, plain.robustness(signals))
    alone = [formula.robustness({name: x[i : i + 1] for name, x in signals.items()})[0] for i in range(7)]
    assert np.array_equal(together, np.stack(alone))


@pytest.mark.parametrize(
    ("text", "place", "message", "hint"),
    [
        ("a = p\na = q\na", (2, 1), "defined twice", "line 1"),
        ("a = b\nb = p\na", (1, 5), "below its use", "line 2"),
        ("a = not a\na", (1, 9), "uses itself", ""),
        ("f(o) = x(o)\nf(o, p)", (2, 1), "takes 1 argument, not 2", "f(o)"),
        ("f(o) = x(o)\nf", (2, 1), "takes 1 argument, not 0", "f(o)"),
        ("a = p\na(o)", (2, 1), "takes no arguments, not 1", ""),
        ("f(o, o) = x(o)\nf(p, q)", (1, 1), "the same name", ""),
        ("f(3) = x(o)\nf(p)", (1, 3), "a parameter must be a name", ""),
        ("f(o) = x(o)", (1, 1), "a formula is missing", "forall"),
        ("f(o) = o > 1\nf(p)", (1, 8), "stands for a vehicle", ""),
        ("near_o = x(o)\nforall o in others: near_o", (1, 12), "a quantifier around its use", "parameter"),
        ("high = o > 1\nforall o in others: x(o) and high", (1, 8), "a quantifier around its use", ""),
        ("a = p > 0\na + 1 > 2", (2, 1), "expected a number", ""),
        ("a = p > 0\nforall a in others: x(a)", (2, 8), "the name of a definition", ""),
        ("const float c = 3", (1, 15), "defines a number", "last statement"),
        ("p > 0\nq > 0", (2, 1), "ended before", "join"),
        ("a = p > 1\n-q > 0", (2, 1), "may continue", ""),
        ("a = p b = q", (1, 7), "'b'", "new line"),
        ("always = p", (1, 8), "'='", "another name"),
        ("p => q", (1, 4), "'>'", "->"),
        ("F[0,c] p", (1, 5), "c is not defined", "const"),
        ("const float c = -1\nF[0,c] p", (2, 5), "not a number of zero or above", ""),
        ("const float c = 0.5\nF[0,c] p", (2, 5), "not a whole multiple", ""),
        ("at_least 2.5 o in others: x(o)", (1, 10), "whole number above 0", ""),
        ("near(o, 3)", (1, 9), "not numbers", ""),
        ("near(ego, x > 3)", (1, 11), "not formulas", ""),
        ("sqr(x) > 1", (1, 4), "not an operator", "'sqrt'"),
        ("forall other in others: x(othr)", (1, 27), "othr is not bound", "'other'"),
        ("forall o in others: x(O)", (1, 23), "O is not bound", "'o'"),
        ("forall o in cars: x(o, cars)", (1, 24), "a group", "forall"),
        ("exists[2] o in others: x(o)", (1, 7), "'['", "at_least"),
        ("(p > 0}", (1, 7), "does not close", ""),
        ("p $ q", (1, 3), "'$'", ""),
        ("p /* q", (1, 4), "unterminated comment", "*/"),
        ("p and # q\n", (1, 6), "ends early", ""),
        ("p until[0 q", (1, 11), "'q'", "[0,3]"),
        ("forall o in others p", (1, 20), "a colon", ""),
    ],
)  # fmt: skip
def test_errors_point_at_the_place(text, place, message, hint):
    with pytest.raises(FormulaError) as caught:
        parse(text)
    first, shown, mark = caught.value.message.split("\n")
    assert first.startswith(f"line {place[0]}, column {place[1]}: ")
    assert message in first
    assert (shown, mark) == ("  " + text.split("\n")[place[0] - 1], "  " + " " * (place[1] - 1) + "^")
    assert hint in (caught.value.hint or "")


@pytest.mark.parametrize(
    ("text", "columns"),
    [
        ("always p and q", [1]),
        ("p > 1 -> always[0,3] p -> q", None),
        ("p and G not q or r", [7]),
        ("always p until q", [1]),
        ("F p xor (q)", [1, 5]),
        ("not once p -> q", [5]),
        ("prev p and q or r", [1]),
        ("(always p) and q", []),
        ("always (p) and q", []),
        ("always {p} and q", []),
        ("p and always q", []),
        ("always eventually[0,2] (p > 1) and (q)", []),
        ("not p and q", []),
        ("rise(p) and q", []),
        ("p and not once[0,1](a and prev not b) -> q", []),
        ("forall o in others: always x(o) -> y(o)", [21]),
        ("p iff q iff r", [3]),
        ("p == 1 and q == 2 and q !== 2", [3, 25]),
        ("a = p; b = a; c = q; c", [8]),
        ("a = b", [3]),
        ("a = b; c = a", []),
        ("next_to(o, ego)", []),
        ("forall o in others: exits(o)", []),
        ("speed(car_13) > 3", []),
        ("rises(ego)", []),
        ("G > 1", []),
        ("always p and always q", []),
        ("eventually p or next q", []),
        ("always p -> eventually q", []),
        ("p = q", [3]),
        ("p = q + 1", [3]),
        ("p = -q", [3]),
        ("p = abs(q)", [3]),
    ],
)
def test_warnings(text, columns):
    if columns is None:
        with pytest.raises(FormulaError):
            parse(text)
        return
    node, warnings = parse_with_warnings(text)
    assert node == parse(text)
    assert [int(re.search(r"column (\d+): ", each.message)[1]) for each in warnings] == columns
    for warning, column in zip(warnings, columns, strict=True):
        assert isinstance(warning, LintWarning)
        assert warning.message.split("\n")[1:] == ["  " + text, "  " + " " * (column - 1) + "^"]
        assert warning.hint
        assert ("'=' does not compare" in warning.message) == (columns == [3] and " = " in text)


@pytest.mark.parametrize(
    ("text", "warned"),
    [
        ("(x < 0.5) until[0,1] (x >= 0.5)", True),
        ("(x < 0.5) S (x >= 0.5)", True),
        ("((x < 0.5) or (x >= 0.5)) unless (x >= 0.5)", False),
        ("(x < 0.5) until (y > 0)", False),
    ],
)
def test_a_closed_until_about_one_signal_is_a_warning(text, warned):
    found = [warning.message for warning in stl(text, warn=False).warnings]
    assert any("must hold where the right one does" in message for message in found) == warned
    assert stl(text, until="half-open", warn=False).warnings == ()


def test_the_hint_of_a_closed_until_is_the_half_open_reading():
    x = np.random.default_rng(0).normal(0.5, 0.3, (50, 6))
    half = stl("(x < 0.5) until[0,3] (x >= 0.5)", until="half-open").robustness({"x": x})
    written = stl("((x < 0.5) or (x >= 0.5)) until[0,3] (x >= 0.5)", warn=False).robustness({"x": x})
    np.testing.assert_array_equal(written, half)


def test_a_derived_formula_keeps_its_tree_at_another_step():
    formula = stl("always (x > 0)")
    derived = replace(formula, derived=formula.node.child)
    assert derived.at(0.1).node == formula.node.child
    timed = stl("always[0,2] (x > 0)")
    with pytest.raises(FormulaError, match="takes 1 s for a sample"):
        replace(timed, derived=timed.node.child).at(0.1)
