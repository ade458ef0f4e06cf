"""What other programs read: JUnit XML for the CI server, Markdown for a merge request."""

from __future__ import annotations

import re
from collections.abc import Sequence
from xml.etree import ElementTree

from avrare.check.claims import Row
from avrare.check.gate import Outcome
from avrare.report.console import number

_UNPRINTABLE = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
_SIGNS = {"pass": "✅ pass", "fail": "❌ fail", "inconclusive": "❔ inconclusive"}


def junit(outcome: Outcome) -> str:
    """One suite a scenario, one case a row: failed, skipped (inconclusive), or in error (broken rollouts)."""
    top = ElementTree.Element("testsuites", name="avrare check")
    for scenario, results in outcome.results.items():
        rows = [one for one in outcome.rows if one.scenario == scenario]
        broken = {one.specification: one.health["errors"] for one in results if "errors" in one.health}
        cases = [_case(one, broken.get(one.specification)) for one in rows]
        counts = {
            name: str(sum(case.find(tag) is not None for case in cases))
            for name, tag in (("failures", "failure"), ("errors", "error"), ("skipped", "skipped"))
        }
        seconds = sum(one.seconds for one in results)
        about = {"name": _printable(scenario), "tests": str(len(cases)), "time": f"{seconds:.3f}"}
        suite = ElementTree.SubElement(top, "testsuite", about | counts)
        suite.extend(cases)
    ElementTree.indent(top)
    return ElementTree.tostring(top, encoding="unicode", xml_declaration=True) + "\n"


def _case(row: Row, broken: str | None) -> ElementTree.Element:
    case = ElementTree.Element(
        "testcase",
        classname=_printable(f"avrare.{row.scenario}"),
        name=_printable(row.name),
        time=f"{row.seconds:.3f}",
    )
    tag = {"pass": None, "fail": "failure", "inconclusive": "skipped"}[row.verdict]
    reason = row.reason
    if broken is not None and row.verdict != "fail":
        tag, reason = "error", broken
    if tag is not None:
        ElementTree.SubElement(case, tag, type=row.verdict, message=_printable(f"{row.verdict}: {reason}"))
    output = ElementTree.SubElement(case, "system-out")
    output.text = _printable("\n".join(f"{name}: {text}" for name, text in _facts(row).items()))
    return case


def markdown(outcome: Outcome) -> str:
    """A table with verdicts, estimates and changes, and what to know when reading it."""
    head = ("scenario", "rule", "wanted", "verdict", "probability", "interval", "baseline", "change")
    lines = [f"### avrare check: {_SIGNS[outcome.verdict]}", "", _cells(head), _cells(["---"] * len(head))]
    for row in outcome.rows:
        facts = _facts(row)
        texts = [row.scenario, row.specification, row.question]
        lines.append(_cells([*map(_escaped, texts), _SIGNS[row.verdict], *map(_escaped, facts.values())]))
    remarks = [f"{one.scenario} {one.name}: {one.reason}" for one in outcome.rows if one.reason]
    remarks += outcome.notes
    if remarks:
        lines += ["", *(f"- {_escaped(text)}" for text in remarks)]
    return "\n".join(lines) + "\n"


def _cells(texts: Sequence[str]) -> str:
    return "| " + " | ".join(texts) + " |"


def _facts(row: Row) -> dict[str, str]:
    """The row's numbers as they are shown; "-" where there is none."""
    return {
        "probability": _or_dash(row.probability),
        "interval": f"{number(row.interval[0], 2)} .. {number(row.interval[1], 2)}" if row.interval else "-",
        "baseline": _or_dash(row.baseline),
        "change": change(row),
    }


def _or_dash(value: float | None) -> str:
    return "-" if value is None else number(value)


def change(row: Row) -> str:
    """``x 1.9 (1.3 .. 2.8)``: against the baseline; "-" without one."""
    if row.change_interval is None:
        return "-"
    low, high = (f"{end:.2g}" if end < 1e9 else "∞" for end in row.change_interval)
    ratio = "?" if row.change is None else f"{row.change:.2g}" if row.change < 1e9 else "∞"
    return f"x {ratio} ({low} .. {high})"


def _escaped(text: str) -> str:
    """Text that Markdown shows as it is, on one line, inside a table or out of it."""
    words = " ".join(_printable(text).split()).replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
    return re.sub(r"([\\`*_{}\[\]()#|!~@])", r"\\\1", words)


def _printable(text: str) -> str:
    """Without the characters that XML cannot hold."""
    return _UNPRINTABLE.sub("\ufffd", text)
