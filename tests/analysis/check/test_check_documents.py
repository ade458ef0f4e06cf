"""JUnit and Markdown of a check: well-formed for any text."""

from dataclasses import replace
from xml.etree import ElementTree

import pytest

from avrare.analysis.check.criteria import Decision
from avrare.analysis.check.gate import CheckResult
from avrare.estimation.result.note import describe_blind_bound
from avrare.output.documents import annotate_rows, junit, markdown

NASTY = 'a <b> & "c" | `d` *e* \x00\x1b[31m ]]> \ud800 é\nnew line'


@pytest.fixture
def outcome(estimate):
    rows = (
        Decision("one", "lane", "threshold", "< 0.02", "pass", "", 0.01, (0.008, 0.01), seconds=2.5),
        Decision("one", "lane", "regression", "<= baseline", "fail", NASTY, 0.01, (0.008, 0.012), 0.0,
            float("inf"), (2.0, float("inf")), 9, 2.5),
        Decision("two", "gap", "threshold", "< 1", "inconclusive", NASTY),
        Decision("two", "bad", "threshold", "< 1", "inconclusive", "errors: ..."),
    )  # fmt: skip
    broken = estimate(specification="bad", health={"errors": "20 of 100"})
    return CheckResult(rows, {"one": (estimate(),), "two": (broken,)}, notes=("note " + NASTY,))


def test_junit_has_one_case_per_row(outcome):
    top = ElementTree.fromstring(junit(outcome).encode())
    assert [suite.get("name") for suite in top] == ["one", "two"]
    counts = [{key: suite.get(key) for key in ("tests", "failures", "errors", "skipped")} for suite in top]
    assert counts == [
        {"tests": "2", "failures": "1", "errors": "0", "skipped": "0"},
        {"tests": "2", "failures": "0", "errors": "1", "skipped": "1"},
    ]
    cases = {(case.get("classname"), case.get("name")): case for case in top.iter("testcase")}
    assert len(cases) == 4
    passed = cases["avrare.one", "lane < 0.02"]
    assert [child.tag for child in passed] == ["system-out"]
    assert passed.get("time") == "2.500"
    failure = cases["avrare.one", "lane <= baseline"].find("failure")
    assert failure.get("message").startswith('fail: a <b> & "c"')
    assert "change: x ∞ (2 .. ∞)" in cases["avrare.one", "lane <= baseline"].find("system-out").text
    assert cases["avrare.two", "bad < 1"].find("error").get("message").endswith("20 of 100")


def test_an_assumption_passes_and_is_said(outcome):
    reason = "holds as far as the search could see; ..."
    assuming = replace(outcome.decisions[0], verdict="pass_assuming", reason=reason)
    outcome = replace(outcome, decisions=(assuming,), results={"one": outcome.results["one"]})
    (case,) = ElementTree.fromstring(junit(outcome).encode()).iter("testcase")
    assert [child.tag for child in case] == ["system-out"]
    assert case.find("system-out").text.startswith(f"pass_assuming: {reason}")
    assert f"- one lane &lt; 0.02: {reason}" in markdown(outcome).replace("\\", "")
    assert [replace(outcome, strict=strict).exit_code for strict in (False, True)] == [0, 3]
    (line,) = annotate_rows(outcome, {"one": "missing.yaml"})
    assert line.startswith("::notice file=missing.yaml,line=1")
    assert reason in line


def test_markdown_keeps_its_columns(outcome):
    text = markdown(outcome)
    table = [line for line in text.splitlines() if line.startswith("|")]
    assert len(table) == 6
    assert {line.replace("\\|", "").count("|") for line in table} == {9}
    assert "<b>" not in text
    assert "\x1b" not in text
    remarks = [line for line in text.splitlines() if line.startswith("- ")]
    assert len(remarks) == 4
    assert "x ∞ \\(2 .. ∞\\)" in text


def test_markdown_says_what_a_score_may_miss(outcome, estimate):
    blind = estimate(notes=describe_blind_bound(1.2e-3))
    text = markdown(replace(outcome, results={"one": (blind, estimate())}))
    (line,) = [line for line in text.splitlines() if "does not lead to" in line]
    assert line == "- one rule: Failures that the score does not lead to could be as likely as 0.0012."
