"""Messages of `validate` on formulas, before anything runs."""

import pytest

from avrare.logic.syntax.nodes import bounded_span
from avrare.logic.syntax.parser import parse
from avrare.scenario.specification_checks import reach_warnings

FAR = "{plugin: book, rule: R_G2}"


def test_an_error_shows_the_place_in_the_file_and_in_the_formula(good, fails):
    lines, code = fails(good.replace(FAR, '{stl: "always (gap > )"}'))
    assert code == 4
    first, formula, caret = lines[0].split("\n")
    assert first.startswith("s.yaml:10:14: specifications.far.stl: line 1, column 15: ")
    assert formula == "  always (gap > )"
    assert caret.index("^") == formula.index(")")


def test_bounds_are_checked_against_the_simulators_step(good, fails, read):
    text = good.replace(FAR, '{stl: "always[0:0.25s] (gap > 2)"}')
    assert "not a whole multiple of dt = 0.1 s" in fails(text)[0][0]
    assert read(text.replace("dt: 0.1", "dt: 0.05")).warnings == ()


def test_a_bound_beyond_the_rollout_is_a_warning(good, read):
    text = good.replace(FAR, '{stl: "eventually[0:6s] (gap > 2)"}')
    [(message, hint)] = read(text).warnings
    assert hint is None
    assert message == (
        "s.yaml:10:14: specifications.far.stl: the formula looks 60 samples ahead but a rollout ends "
        "after 40: windows are clipped at its last sample"
    )


@pytest.mark.parametrize(
    ("text", "span"),
    [
        ("always[0:4] p", 4),
        ("always eventually p", 0),
        ("always (p -> eventually[0:10] (q and next next p))", 12),
        ("always (p -> (q until[2:6] p) or always[0:3] eventually[1:5] q)", 8),
        ("eventually[7:inf] p", 7),
        ("always (p -> once[0:50] q)", 0),
        ("forall o in others: always (p -> next q)", 1),
    ],
)
def test_only_bounded_future_operators_count(text, span):
    node = parse(text)
    assert bounded_span(node) == span
    assert reach_warnings(node, span) == []
    for steps in range(span):
        [words] = reach_warnings(node, steps)
        assert words.startswith(f"the formula looks {span} samples ahead but a rollout ends after {steps}: ")


def test_warnings_of_the_formula_language_are_passed_on(good, read):
    text = good.replace(FAR, '{stl: "always gap > 2 and speed > 0"}')
    [(message, hint)] = read(text).warnings
    assert message.startswith("s.yaml:10:14: specifications.far.stl: line 1, column 1: ")
    assert "always (... and ...)" in hint
    assert read(good.replace(FAR, '{stl: "(always gap > 2) and speed > 0"}')).warnings == ()
