"""Numbers in the words of a report."""

import pytest

from avrare.base.number_format import format_amount_in_words, format_interval, format_typeset


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (0.0, "0"),
        (1.0, "1"),
        (0.01234, "0.0123"),
        (3.44e-5, "3.4 × 10⁻⁵"),
        (None, "–"),
        (1e-12, "1.0 × 10⁻¹²"),
    ],
)
def test_numbers_are_formatted_for_people(value, words):
    assert format_typeset(value) == words


def test_amounts_are_written_in_words():
    words = {12.3: "12", 1234.0: "1,200", 3.44e6: "3.4 million", 1.23e8: "120 million", 9.99e8: "1.0 × 10⁹"}
    assert {value: format_amount_in_words(value) for value in words} == words


def test_a_bound_below_one_is_told_from_one():
    assert format_interval((0.9963, 1.0)) == "0.996 .. 1"
    assert format_interval((0.2, 0.99)) == "0.2 .. 0.99"
