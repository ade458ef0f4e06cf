"""HTML report of a run folder: one self-contained file with style, script and data."""

from __future__ import annotations

import base64
import hashlib
import shlex
from importlib.resources import files
from pathlib import Path

from avrare.report.html.estimates import allow_breaks, render_estimates
from avrare.report.html.markup import Markup, tag
from avrare.report.html.specification import render_sections
from avrare.report.html.verdict import render_sign, render_verdict
from avrare.results.run import Run


def render_report(path: Path) -> str:
    """Return the report of a run folder as HTML."""
    return render_run(Run.read(path))


def render_run(run: Run) -> str:
    """Return the report of a run as HTML."""
    script = _read_asset("script.js")
    sections = [*render_sections(run), _render_provenance(run)]
    body = tag(
        "body",
        tag("a", "To the estimates", href="#estimates", class_="skip"),
        _render_navigation(run),
        _render_header(run),
        tag("main", render_verdict(run), render_estimates(run), _render_errors(run), sections),
        tag("footer", f"Made by avrare {run.versions.get('avrare', '')}"),
        tag("script", Markup(script)),
    )
    return "<!doctype html>\n" + tag("html", _render_head(run, script), body, lang="en") + "\n"


def _render_head(run: Run, script: str) -> Markup:
    # The policy allows only this script, and loads nothing.
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    policy = f"default-src 'none'; style-src 'unsafe-inline'; img-src data:; script-src 'sha256-{digest}'"
    return tag(
        "head",
        tag("meta", charset="utf-8"),
        tag("meta", http_equiv="Content-Security-Policy", content=policy),
        tag("meta", name="viewport", content="width=device-width, initial-scale=1"),
        tag("meta", name="color-scheme", content="light dark"),
        tag("title", f"{run.name} · avrare"),
        tag("style", Markup(_read_asset("style.css"))),
    )


def _render_header(run: Run) -> Markup:
    description = None if run.definition is None else run.definition.description
    estimators = ", ".join(dict.fromkeys(result.estimator for result in run.values()))
    commit = run.provenance.commit
    facts = [
        f"estimator {estimators}", f"seed {run.seed}", f"{run.written:%d %B %Y, %H:%M} UTC",
        f"commit {commit[:10]}" if commit else None,
    ]  # fmt: skip
    return tag(
        "header",
        tag("button", "Theme: auto", id="theme", type="button"),
        tag("h1", run.name),
        tag("p", description, class_="description") if description else None,
        tag("p", " · ".join(fact for fact in facts if fact), class_="muted"),
    )


def _render_navigation(run: Run) -> Markup:
    links = [tag("a", "Verdict", href="#verdict"), tag("a", "Estimates", href="#estimates")]
    for index, result in enumerate(run.values()):
        sign = tag("span", render_sign(result.verdict), class_=f"sign {result.verdict or 'none'}")
        links.append(tag("a", sign, allow_breaks(result.specification), href=f"#specification-{index}"))
    links.append(tag("a", "Commands", href="#provenance"))
    return tag("nav", links, aria_label="Sections")


def _render_errors(run: Run) -> list[Markup]:
    found = []
    if run.build_errors:
        text = "The scenario of this run cannot be built here, so everything that needs it is missing:"
        found.append((text, run.build_errors))
    if run.changes:
        found.append(("What is shown of the scenario may not be what was run:", run.changes))
    return [
        tag("section", tag("p", text), tag("pre", "\n".join(lines)), class_="note", role="note")
        for text, lines in found
    ]


def _render_provenance(run: Run) -> Markup:
    origin = run.provenance
    commit = origin.commit
    changed = " with uncommitted changes" if origin.uncommitted_changes else ""
    original = shlex.join([Path(origin.command[0]).name, *origin.command[1:]]) if origin.command else ""
    rows = [
        ("fingerprint", tag("code", run.fingerprint)) if run.fingerprint else None,
        ("commit", tag("code", f"{commit}{changed}") if commit else "none"),
        ("Python", origin.python or "–"),
        ("budget", origin.budget or "the estimator's own options"),
        *run.versions.items(),
    ]
    return tag(
        "section",
        tag("h2", "How these numbers were made"),
        tag("p", "Probabilities, intervals, verdicts and charts of estimates:"),
        tag("pre", run.reproduction, class_="command target", tabindex=0, id="command-run"),
        tag("p", "Original command:") if original else None,
        tag("pre", original, class_="command", tabindex=0) if original else None,
        _render_commands(run),
        tag("dl", [tag("div", tag("dt", row[0]), tag("dd", row[1])) for row in rows if row], class_="origin"),
        tag("details", tag("summary", "Scenario with all defaults"), tag("pre", run.scenario_text))
        if run.scenario_text
        else None,
        id="provenance",
    )


def _render_commands(run: Run) -> Markup | None:
    if run.folder is None:
        return None
    text = "This report; kinds, what to fix first and each failure have their commands beside them:"
    command = shlex.join(["avrare", "report", str(run.folder)])
    return tag("div", tag("p", text), tag("pre", command, class_="command", tabindex=0))


def _read_asset(name: str) -> str:
    return files("avrare.report.html").joinpath(name).read_text(encoding="utf-8")
