"""The page of untuned problems: what counts as confidently wrong, and which problems miss the goals."""

import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def untuned():
    sys.path.insert(0, str(ROOT / "benchmarks"))
    try:
        import untuned

        return untuned
    finally:
        sys.path.remove(str(ROOT / "benchmarks"))


def cell(untuned, outcomes):
    found = [
        untuned.Outcome(i, 1e-3, *interval, 0.0, 100, names) for i, (interval, names) in enumerate(outcomes)
    ]
    return untuned.Cell("x", "ce", 1e-3, found)


RIGHT, NEAR, FAR = (0.5e-3, 2e-3), (0.4e-3, 0.9e-3), (1e-4, 3e-4)


def test_a_row_counts_unwarned_results_that_are_far_off(untuned):
    found = cell(untuned, [(RIGHT, ()), (NEAR, ()), (FAR, ()), (FAR, ("unchecked",))])
    assert found.row() == "| x | ce | 0.001 | 4 | 1.00 | 25.0 | 25.0 | 33.3 | 25.0 | 25.0 | 100 |"


def test_goals_name_the_problems_that_miss_them(untuned):
    silent = cell(untuned, [(RIGHT, ())] * 40)
    short = cell(untuned, [(RIGHT, ())] * 36 + [(NEAR, ())] * 3 + [(FAR, ())])
    loud = cell(untuned, [(RIGHT, ())] * 30 + [(RIGHT, ("unchecked",))] * 10)
    few = cell(untuned, [(FAR, ())] * 39)
    assert untuned.goals("ce", [silent, few]) == "| `ce` | 79 | 49.4 | none | none | none |"
    assert untuned.goals("ce", [short]) == "| `ce` | 40 | 2.5 | x (1 of 40) | x (36 of 40) | none |"
    assert untuned.goals("ce", [loud]) == "| `ce` | 40 | 0.0 | none | none | x (25%) |"
