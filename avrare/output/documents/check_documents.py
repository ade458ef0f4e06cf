"""Documents of a check: JUnit XML for the CI server, Markdown for a merge request."""

from __future__ import annotations

from collections.abc import Sequence
from xml.etree import ElementTree

from avrare.analysis.check.criteria import Decision
from avrare.analysis.check.gate import CheckResult
from avrare.base.number_format import format_interval, format_probability
from avrare.base.visible_text import escape_markdown, escape_xml

_SIGNS = {
    "pass": "✅ pass",
    "pass_assuming": "☑️ pass, assuming",
    "fail": "❌ fail",
    "inconclusive": "❔ inconclusive",
}


def junit(outcome: CheckResult) -> str:
    """Return one suite per scenario and one case per decision: failed, skipped (inconclusive), or error."""
    top = ElementTree.Element("testsuites", name="avrare check")
    for scenario, results in outcome.results.items():
        errors = {row.specification: row.health["errors"] for row in results if "errors" in row.health}
        cases = [
            _case(row, errors.get(row.specification)) for row in outcome.decisions if row.scenario == scenario
        ]
        counts = {
            name: str(sum(case.find(tag) is not None for case in cases))
            for name, tag in (("failures", "failure"), ("errors", "error"), ("skipped", "skipped"))
        }
        seconds = sum(row.seconds for row in results)
        attributes = {"name": escape_xml(scenario), "tests": str(len(cases)), "time": f"{seconds:.3f}"}
        suite = ElementTree.SubElement(top, "testsuite", attributes | counts)
        suite.extend(cases)
    ElementTree.indent(top)
    return ElementTree.tostring(top, encoding="unicode", xml_declaration=True) + "\n"


def _case(decision: Decision, error: str | None) -> ElementTree.Element:
    names = {"classname": escape_xml(f"avrare.{decision.scenario}"), "name": escape_xml(decision.name)}
    case = ElementTree.Element("testcase", names, time=f"{decision.seconds:.3f}")
    tag = {"fail": "failure", "inconclusive": "skipped"}.get(decision.verdict)
    reason = "; ".join(filter(None, [decision.reason, decision.next_step]))
    if error is not None and decision.verdict != "fail":
        tag, reason = "error", error
    if tag is not None:
        message = escape_xml(f"{decision.verdict}: {reason}")
        ElementTree.SubElement(case, tag, type=decision.verdict, message=message)
    output = ElementTree.SubElement(case, "system-out")
    lines = [f"{name}: {text}" for name, text in format_numbers(decision).items()]
    if decision.verdict == "pass_assuming":
        lines.insert(0, f"{decision.verdict}: {reason}")
    output.text = escape_xml("\n".join(lines))
    return case


def markdown(outcome: CheckResult) -> str:
    """Return a table of verdicts, estimates and changes, with the reasons and notes below it."""
    head = ("scenario", "rule", "wanted", "verdict", "probability", "interval", "baseline", "change")
    lines = [f"### avrare check: {_SIGNS[outcome.verdict]}", "", _row(head), _row(["---"] * len(head))]
    for decision in outcome.decisions:
        texts, numbers = (
            [decision.scenario, decision.specification, decision.question],
            format_numbers(decision).values(),
        )
        lines.append(
            _row([*map(escape_markdown, texts), _SIGNS[decision.verdict], *map(escape_markdown, numbers)])
        )
    remarks = [
        f"{decision.scenario} {decision.name}: {text}"
        for decision in outcome.decisions
        for text in (decision.reason, decision.next_step)
        if text
    ]
    remarks += [*outcome.notes, *list_notes(outcome)]
    if remarks:
        lines += ["", *(f"- {escape_markdown(text)}" for text in remarks)]
    return "\n".join(lines) + "\n"


def list_notes(outcome: CheckResult) -> list[str]:
    """Return a line for each note of an estimate."""
    return [
        f"{scenario} {result.specification}: {note.text}"
        for scenario, results in outcome.results.items()
        for result in results
        for note in result.notes
    ]


def format_numbers(decision: Decision) -> dict[str, str]:
    """Return probability, interval, baseline and change as they are shown; "-" where there is none."""
    p, baseline, interval = decision.probability, decision.baseline, decision.interval
    return {
        "probability": "-" if p is None else format_probability(p),
        "interval": format_interval(interval) if interval else "-",
        "baseline": "-" if baseline is None else format_probability(baseline),
        "change": _format_change(decision),
    }


def _format_change(decision: Decision) -> str:
    # the ratio to the baseline: ``x 1.9 (1.3 .. 2.8)``
    if decision.change_interval is None:
        return "-"
    low, high = (f"{end:.2g}" if end < 1e9 else "∞" for end in decision.change_interval)
    change = decision.change
    if change is None:
        return "not known"
    ratio = f"{change:.2g}" if change < 1e9 else "∞"
    return f"x {ratio} ({low} .. {high})"


def _row(texts: Sequence[str]) -> str:
    return "| " + " | ".join(texts) + " |"
