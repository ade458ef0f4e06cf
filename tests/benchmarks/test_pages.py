"""A study of fewer cells does not empty the page that it belongs to."""

import importlib.util
from pathlib import Path

import pytest

_SOURCE = Path(__file__).parents[2] / "benchmarks" / "studies" / "pages.py"


@pytest.fixture
def pages():
    spec = importlib.util.spec_from_file_location("pages", _SOURCE)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_a_page_keeps_the_rows_that_a_study_does_not_have(pages, tmp_path, capsys):
    page = tmp_path / "docs.md"
    page.write_text("# a\n| x | y |\n| 1 | 2 |\n")
    (tmp_path / "results").mkdir()
    assert not pages.put(page, "# a\n| x | y |\nlonger, but with a row less\n", tmp_path / "results")
    assert "| 1 | 2 |" in page.read_text()
    assert "longer" in (tmp_path / "results" / "docs.md").read_text()
    assert "docs.md stays, its tables have 2 rows, not 1" in capsys.readouterr().out


def test_lines_are_put_between_the_marks_of_a_page(pages):
    text = pages.fill("a\n<!-- t -->\nold\n<!-- end of t -->\nb\n", "t", ["new", "rows"])
    assert text == "a\n<!-- t -->\nnew\nrows\n<!-- end of t -->\nb\n"
    with pytest.raises(ValueError, match="end of missing"):
        pages.fill(text, "missing", [])
