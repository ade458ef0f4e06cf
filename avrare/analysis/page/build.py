"""Model of the page of a run: built once, drawn by any renderer."""

from __future__ import annotations

import math
import shlex
from collections.abc import Sequence
from pathlib import Path

from avrare.analysis.page.model import Estimate, Limit, Notice, Origin, ReportModel
from avrare.analysis.page.section import build_sections
from avrare.analysis.page.verdict import build_summary
from avrare.base.chart import Scale, make_log_scale
from avrare.estimation.result.result import Result
from avrare.results.run import Run


def build_report(run: Run) -> ReportModel:
    """Return everything that the page of a run shows; its stored rollouts are replayed."""
    estimates = [_build_estimate(run, result) for result in run.values()]
    definition = run.definition
    return ReportModel(
        run.name,
        run.versions.get("avrare", ""),
        "" if definition is None else definition.description or "",
        _list_facts(run),
        build_summary(estimates, None if definition is None else definition.exposure),
        _make_axis(estimates),
        tuple(_list_notices(run)),
        build_sections(run, estimates),
        _build_origin(run),
    )


def _list_facts(run: Run) -> tuple[str, ...]:
    estimators = ", ".join(dict.fromkeys(result.estimator for result in run.values()))
    facts = [f"estimator {estimators}", f"seed {run.seed}", f"{run.written:%d %B %Y, %H:%M} UTC"]
    commit = run.provenance.commit
    return (*facts, f"commit {commit[:10]}") if commit else tuple(facts)


def _build_estimate(run: Run, result: Result) -> Estimate:
    limits = run.thresholds(result.specification)
    return Estimate(
        result.specification,
        result.verdict,
        result.probability,
        result.interval,
        result.confidence,
        result.relative_error if math.isfinite(result.relative_error) else None,
        result.rollouts,
        result.failures.count,
        result.errors,
        result.seconds,
        tuple(Limit(threshold.strict, threshold.limit) for threshold in limits),
        tuple(result.health.items()),
        tuple(note.text for note in result.notes),
        result.blind_bound,
    )


def _make_axis(estimates: Sequence[Estimate]) -> Scale:
    # An interval from 0 gets a decade of its own.
    values: list[float] = []
    for estimate in estimates:
        low, high = estimate.interval
        values += [low, high, estimate.probability, *(limit.limit for limit in estimate.limits)]
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
