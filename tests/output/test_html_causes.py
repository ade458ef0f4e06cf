"""Kinds of failure and what to fix first, in the report."""

import json
import shutil

import pytest

from avrare.cli.main import main
from avrare.output.report import render_report


def first_card(html):
    return html[html.index('id="verdict"') : html.index('id="estimates"')]


@pytest.fixture
def folder(made, tmp_path):
    return shutil.copytree(made, tmp_path / "run")


@pytest.fixture
def analysed(folder, capsys):
    words = ["why", str(folder), "--out", str(folder), "--specification", "left", "--fresh", "20"]
    assert main(words) == 0
    capsys.readouterr()
    return folder


def test_without_an_analysis_the_report_has_the_command_that_makes_it(folder):
    page = render_report(folder)
    assert f"avrare why {folder} --specification left --out {folder} --shrink" in page
    assert "Kinds of failure, and what to fix first" in page


def test_the_kinds_and_the_savings_are_shown(analysed):
    page = render_report(analysed)
    assert "kind of failure</h3>" in page or "kinds of failure</h3>" in page
    assert "x &lt; 1 is violated first" in page
    assert "What to fix first</h3>" in page
    assert "no noise beyond 2.5 sigma" in page
    assert f"avrare why {analysed} --specification left --out {analysed} --shrink" in page
    section = page[page.index('id="specification-0"') : page.index('id="specification-1"')]
    assert "Not analysed" not in section
    stored = json.loads((analysed / "why.json").read_text())["kinds"]["left"]
    assert f'href="#failure-left-{stored["kinds"][0]["representative"]}"' in section
    assert "failures in the plane of their two principal components" in section


def test_without_fresh_tapes_the_failures_that_vanish_are_shown_alone(analysed, capsys):
    words = ["why", str(analysed), "--out", str(analysed), "--specification", "left", "--fresh", "0"]
    assert main(words) == 0
    page = render_report(analysed)
    table = page[page.index("What to fix first</h3>") :]
    table = table[: table.index("</table>")]
    first = json.loads((analysed / "why.json").read_text())["attribution"]["left"]["perfect"][0]
    assert 0.0 < first["vanish_low"] < first["vanish"] <= first["vanish_high"] <= 1.0
    assert first["text"].endswith("; new ones were not looked for")
    assert f">{first['text']}</td>" in table


def test_what_is_decisive_and_when_it_was_lost_are_shown(analysed):
    stored = json.loads((analysed / "why.json").read_text())
    stored["kinds"]["left"]["kinds"][0] |= {"decisive": "car 0.2 m too far left", "lost": "lost at t = 1.0 s"}
    (analysed / "why.json").write_text(json.dumps(stored))
    page = render_report(analysed)
    assert "It needs only this: car 0.2 m too far left." in page
    assert "<p>Lost at t = 1.0 s.</p>" in page


def test_the_first_card_says_what_happens_and_what_helps_or_that_it_was_not_looked_for(folder, analysed):
    card = first_card(render_report(analysed))
    assert "What happens: x &lt; 1 is violated first, at about" in card
    best = json.loads((analysed / "why.json").read_text())["attribution"]["left"]["perfect"][0]
    assert f"What helps most: {best['perfect']} {best['text']}." in card
    (analysed / "why.json").unlink()
    card = first_card(render_report(analysed))
    assert "Not looked for: the causes and what would help." in card


def test_an_analysis_of_another_result_is_not_shown(analysed):
    stored = json.loads((analysed / "why.json").read_text())
    stored["kinds"]["left"]["probability"] *= 1.01
    (analysed / "why.json").write_text(json.dumps(stored))
    assert "x &lt; 1 is violated first" not in render_report(analysed)


def test_a_damaged_analysis_is_a_note(analysed):
    (analysed / "why.json").write_text('{"kinds": {"left": {"probability": "often", "kinds": []}}}')
    page = render_report(analysed)
    assert "kinds.left.probability" in page
    assert "What to fix first</h3>" not in page
