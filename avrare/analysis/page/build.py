"""Model of the page of a run: built once, drawn by any renderer."""

from __future__ import annotations

import shlex
from pathlib import Path

from avrare.analysis.page.model import Notice, Origin, ReportModel
from avrare.analysis.page.section import build_sections
from avrare.analysis.page.verdict import build_summary
from avrare.base.chart import Scale, make_log_scale
from avrare.results.run import Run


def build_report(run: Run) -> ReportModel:
    """Return everything that the page of a run shows; its stored rollouts are replayed."""
    return ReportModel(
        run.name,
        run.versions.get("avrare", ""),
        (run.definition and run.definition.description) or "",
        _list_facts(run),
        build_summary(run),
        _make_axis(run),
        tuple(_list_notices(run)),
        build_sections(run),
        _build_origin(run),
    )


def _list_facts(run: Run) -> tuple[str, ...]:
    estimators = ", ".join(dict.fromkeys(result.estimator for result in run.values()))
    facts = [f"estimator {estimators}", f"seed {run.seed}", f"{run.written:%d %B %Y, %H:%M} UTC"]
    commit = run.provenance.commit
    return (*facts, f"commit {commit[:10]}") if commit else tuple(facts)


def _make_axis(run: Run) -> Scale:
    # An interval from 0 gets a decade of its own.
    values: list[float] = []
    for result in run.values():
        low, high = result.interval
        values += [low, high, result.probability]
        values += [threshold.limit for threshold in run.thresholds(result.specification)]
        values += [high / 10.0] if low <= 0.0 else []
    return make_log_scale(values, most=1.0)


def _list_notices(run: Run) -> list[Notice]:
    notices = []
    if run.build_errors:
        text = "The scenario of this run cannot be built here, so everything that needs it is missing:"
        notices.append(Notice(text, run.build_errors))
    if run.changes:
        notices.append(Notice("What is shown of the scenario may not be what was run:", run.changes))
    return notices


def _build_origin(run: Run) -> Origin:
    provenance = run.provenance
    commit, command = provenance.commit, provenance.command
    changed = " with uncommitted changes" if provenance.uncommitted_changes else ""
    facts = [("fingerprint", run.fingerprint, True)] if run.fingerprint else []
    facts += [
        ("commit", f"{commit}{changed}" if commit else "none", bool(commit)),
        ("Python", provenance.python or "–", False),
        ("budget", provenance.budget or "the estimator's own options", False),
        *((name, version, False) for name, version in run.versions.items()),
    ]
    return Origin(
        run.reproduction,
        shlex.join([Path(command[0]).name, *command[1:]]) if command else "",
        "" if run.folder is None else shlex.join(["avrare", "report", str(run.folder)]),
        tuple(facts),
        run.scenario_text,
    )
