"""The page of causes: every figure has its place, and the tests that it names exist."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
TEXT = (ROOT / "benchmarks" / "studies" / "trust.md").read_text(encoding="utf-8")


def test_every_figure_has_one_place():
    assert [int(number) for number in re.findall(r"\[now (\d+)\]", TEXT)] == list(range(1, 11))
    assert TEXT.count("[costs]") == 1


def test_the_tests_it_names_exist():
    named = re.findall(r"`((?:tests|plugins)/[^`]+\.py)`", TEXT)
    assert len(named) >= 10
    assert [name for name in named if not (ROOT / name).is_file()] == []


def test_the_page_is_the_template_with_figures():
    page = (ROOT / "docs" / "trust.md").read_text(encoding="utf-8")
    pattern = re.escape(TEXT.strip())
    for place in (*(f"[now {number}]" for number in range(1, 11)), "[costs]"):
        pattern = pattern.replace(re.escape(place), "(.+?)")
    assert re.fullmatch(pattern, page.strip(), re.DOTALL)
