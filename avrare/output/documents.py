"""Documents that other programs read: JUnit XML, Markdown, JSON, annotations of GitHub Actions."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from xml.etree import ElementTree

from avrare.analysis.check.criteria import Decision
from avrare.analysis.check.gate import CheckResult
from avrare.analysis.compare.comparison import ArmResult, Comparison
from avrare.analysis.compare.paired_comparison import PairedComparison
from avrare.analysis.compare.repetition_statistics import Summary, find_disagreements
from avrare.analysis.compare.version_changes import VersionChange
from avrare.base import version
from avrare.base.errors import AvrareError
from avrare.base.number_format import format_interval, format_probability
from avrare.base.visible_text import escape_markdown, escape_xml, spell_controls
from avrare.estimation.result.result import finite
from avrare.scenario.fingerprint import fingerprint
from avrare.scenario.value_positions import Node
from avrare.scenario.yaml import parse

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


_LEVELS = {"fail": "error", "inconclusive": "warning", "pass_assuming": "notice"}


def is_github_job(environment: Mapping[str, str] = os.environ) -> bool:
    """Return whether this process runs in a job of GitHub Actions."""
    return environment.get("GITHUB_ACTIONS") == "true"


def annotate_rows(outcome: CheckResult, paths: Mapping[str, str]) -> list[str]:
    """Return a workflow command for each row that fails (error), is inconclusive (warning), assumes (notice).

    Args:
        outcome: The check.
        paths: File of each scenario or catalogue, by its name.
    """
    return [
        _annotation(decision, paths[decision.scenario])
        for decision in outcome.decisions
        if decision.verdict in _LEVELS
    ]


def write_summary(outcome: CheckResult, environment: Mapping[str, str] = os.environ) -> None:
    """Append the table of the check to the summary of the job, where there is one."""
    path = environment.get("GITHUB_STEP_SUMMARY")
    if path:
        with Path(path).open("a", encoding="utf-8") as file:
            file.write(markdown(outcome) + "\n")


def _annotation(decision: Decision, path: str) -> str:
    numbers = format_numbers(decision)
    title = f"{decision.scenario} {decision.specification} {decision.question}: {decision.verdict}"
    estimate = f"{numbers['probability']} ({numbers['interval']})" if decision.interval else ""
    text = _escape("\n".join(filter(None, [estimate, decision.reason, decision.next_step])))
    place = f"file={_escape_property(path)},line={_find_line(path, decision)}"
    return f"::{_LEVELS[decision.verdict]} {place},title={_escape_property(title)}::{text}"


def _find_line(path: str, decision: Decision) -> int:
    """Return the line of the row's threshold, else of its specification, else the first."""
    try:
        top = parse(Path(path).read_bytes(), path)
    except (OSError, AvrareError):
        return 1
    thresholds = top.child("thresholds")
    for entry in thresholds.items if thresholds is not None and decision.kind == "threshold" else ():
        name = entry.child("specification") or entry.child("rule")
        if name is not None and name.value == decision.specification:
            return entry.mark.line
    specifications = top.child("specifications") or Node({}, top.mark)
    node = specifications.child(decision.specification)
    return node.name_mark.line if node is not None else 1


def _escape(text: str) -> str:
    return spell_controls(text).replace("%", "%25").replace("\r", "%0D").replace("\n", "%0A")


def _escape_property(text: str) -> str:
    return _escape(text).replace(":", "%3A").replace(",", "%2C")


_REPETITION_FIELDS = (
    "probability", "interval", "relative_error", "rollouts", "simulated_steps", "failures", "errors",
    "health", "seconds",
)  # fmt: skip
"""Fields of the entries of a repetition's result."""


def comparison_document(comparison: Comparison) -> dict[str, object]:
    """Return all numbers of a comparison, JSON-ready; NaN and infinities become null."""
    case, design, truth = comparison.case, comparison.design, comparison.truth
    summaries = comparison.summaries
    used = {
        result.arm.distribution: result.arm.version for result in comparison.arms if result.arm.distribution
    }
    content = {
        "schema": 1,
        "comparison": case.name,
        "specification": case.specification or None,
        "fingerprint": case.fingerprint,
        "versions": dict(sorted({**case.versions, **used, "avrare": version.__version__}.items())),
        "steps": case.problem.steps,
        "budget": {design.budget.kind: design.budget.amount},
        "repeat": design.repeat,
        "seed": design.seed,
        "confidence": case.confidence,
        "truth": asdict(truth) if truth else None,
        "interrupted": comparison.interrupted,
        "disagree": find_disagreements([result.arm.label for result in comparison.arms], summaries),
        "estimators": [
            _encode_arm(arm, summary, design.seed)
            for arm, summary in zip(comparison.arms, summaries, strict=True)
        ],
    }
    return finite(content)


def _encode_arm(result: ArmResult, summary: Summary | None, seed: int) -> dict[str, object]:
    entries = [repetition.to_dict() for repetition in result.repetitions]
    return {
        "label": result.arm.label,
        "estimator": result.arm.name,
        "options": result.arm.config.model_dump(mode="json"),
        "refusal": result.refusal.message if result.refusal else None,
        "summary": asdict(summary) if summary else None,
        "repetitions": [
            {"seed": seed + k} | {name: entry[name] for name in _REPETITION_FIELDS}
            for k, entry in enumerate(entries)
        ],
    }


def paired_document(paired: PairedComparison) -> dict[str, object]:
    """Return all numbers of a paired comparison, JSON-ready."""
    versions = {name: number for scenario in paired.scenarios for name, number in scenario.versions.items()}
    content = {
        "schema": 1,
        "first": paired.names[0],
        "second": paired.names[1],
        "fingerprints": [fingerprint(scenario) for scenario in paired.scenarios],
        "versions": dict(sorted({**versions, "avrare": version.__version__}.items())),
        "rollouts": paired.rollouts,
        "seed": paired.seed,
        "confidence": paired.confidence,
        "specifications": [_encode_change(change, paired.confidence) for change in paired.changes],
    }
    return finite(content)


def _encode_change(change: VersionChange, confidence: float) -> dict[str, object]:
    return {
        "specification": change.specification,
        "probability": [change.first, change.second],
        "difference": change.difference,
        "interval": change.interval(confidence),
        "ratio": change.ratio,
        "ratio_interval": change.ratio_interval(confidence),
        "highest": change.highest(confidence),
        **change.document(),
        "verdict": change.verdict(confidence),
    }
