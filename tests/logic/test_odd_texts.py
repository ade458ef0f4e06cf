"""Texts that nobody would write: each is a formula or an error, and never anything else."""

import random
import re
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from avrare.base.errors import FormulaError
from avrare.logic.syntax import nodes as f
from avrare.logic.syntax.lint import LintWarning
from avrare.logic.syntax.parser import parse, parse_with_warnings
from avrare.logic.syntax.printer import to_text as printed

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "formulas.md").read_text()
SEEDS = [
    *re.findall(r"```stl\n(.*?)```", PAGE, re.DOTALL),
    "always[0:3s] (p > 0.2) and not (q - 1 >= -2 * r) until[1,inf] rise(x)",
    "at_least 2 o in others: F[0,2 samples] {near(o, ego)} <-> []{p} || !q; ",
]
PIECES = [
    *sorted({token for text in SEEDS for token in re.findall(r"\w+|[^\w\s]+|\s+", text)}),
    "\n", "=", "G", "F", "U", "S", "X", "ev", "alw_", "const float ", "float x\n", "inf", "/*", "//", "é",
    "\x00", "1e999", "[t]", "{", "}", "[", "]", "(", ")", "<>", "^", "@", "in", "not", "-", ":", ",", "\r",
    "\t", "forall",
]  # fmt: skip


def attempt(text):
    """Return the formula, or the error; anything else than a FormulaError fails the test."""
    try:
        node, warnings = parse_with_warnings(text, 0.1)
    except FormulaError as error:
        return error.message
    assert all(isinstance(each, LintWarning) for each in warnings)
    assert parse(printed(node), 0.1) == node
    return node


@pytest.mark.parametrize("seed", range(4))
def test_random_tokens_are_formulas_or_errors(seed):
    rng = random.Random(seed)
    found = [
        attempt("".join(rng.choice(PIECES) + rng.choice(["", " "]) for _ in range(rng.randint(1, 12))))
        for _ in range(500)
    ]
    assert any(isinstance(each, f.Node) for each in found)
    assert any(isinstance(each, str) for each in found)


@pytest.mark.parametrize("seed", range(4))
def test_random_changes_of_formulas_are_formulas_or_errors(seed):
    rng = random.Random(seed)
    found = []
    for _ in range(300):
        tokens = re.findall(r"\w+|[^\w\s]|\s+", rng.choice(SEEDS))
        for _ in range(rng.randint(1, 4)):
            i, j = rng.randrange(len(tokens) + 1), rng.randrange(len(tokens) + 1)
            tokens[i : i + rng.randint(0, 2)] = rng.choice([[], [rng.choice(PIECES)], tokens[j : j + 3]])
        found.append(attempt("".join(tokens)))
    assert {isinstance(each, f.Node) for each in found} == {True, False}


@settings(max_examples=200, deadline=None, derandomize=True)
@given(st.text(max_size=30))
def test_any_text_is_a_formula_or_an_error(text):
    attempt(text)


@pytest.mark.parametrize(
    "text",
    [
        "(" * 20000 + "p", "p" + ")" * 20000, "-" * 20000 + "p > 0",
        "always " * 5000 + "p", "[" * 20000, "{" * 20000, "not(" * 5000 + "p" + ")" * 5000, "p -> (" * 5000,
        "x" * 100000 + " y", "p\n" * 5000, "p = p;" * 5000, "/*" * 20000, "p " * 20000, "1" * 20000 + " > p",
        "forall o in others: " * 2000 + "p", "\n".join(f"a{i + 1} = a{i}" for i in range(2000)),
        "\n".join([f"a{i + 1} = a{i} and a{i}" for i in range(40)] + ["a40"]), "=" * 20000, "f(" * 5000,
        "p until " * 5000 + "p", "f(o) = " * 3000 + "p", "forall " * 5000, "@topic(" * 5000, "input " * 5000,
    ],
)  # fmt: skip
def test_huge_texts_are_refused(text):
    assert isinstance(attempt(text), str)


@pytest.mark.slow
def test_any_number_of_parentheses_is_accepted():
    assert attempt("(" * 20000 + "p" + ")" * 20000) == parse("p")
