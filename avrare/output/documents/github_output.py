"""Output of a check for GitHub Actions: annotations at the scenario's lines, and the summary of the job."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

from avrare.analysis.check.criteria import Decision
from avrare.analysis.check.gate import CheckResult
from avrare.base.errors import AvrareError
from avrare.base.visible_text import spell_controls
from avrare.output.documents.check_documents import format_numbers, markdown
from avrare.scenario.value_positions import Node
from avrare.scenario.yaml import parse

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
