"""HTML report of a run folder: one self-contained file with style, script and data."""

from __future__ import annotations

import base64
import hashlib
import shlex
from importlib.resources import files
from pathlib import Path

from avrare.report.html.estimate_table import render_estimates, render_verdict
from avrare.report.html.markup import Markup, tag
from avrare.report.html.specification_sections import render_sections
from avrare.results.reader import RunFolder, read_run_folder


def render_report(path: Path) -> str:
    """Return the report of a run folder as HTML."""
    folder = read_run_folder(path)
    script = _read_asset("script.js")
    sections = [*render_sections(folder), _render_provenance(folder)]
    body = tag(
        "body",
        tag("a", "To the estimates", href="#estimates", class_="skip"),
        _render_header(folder),
        tag("main", render_verdict(folder), render_estimates(folder), _render_load_errors(folder), sections),
        tag("footer", f"Made by avrare {folder.result.versions.get('avrare', '')}"),
        tag("script", Markup(script)),
    )
    return "<!doctype html>\n" + tag("html", _render_head(folder, script), body, lang="en") + "\n"


def _render_head(folder: RunFolder, script: str) -> Markup:
    # The policy allows only this script, and loads nothing.
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    policy = f"default-src 'none'; style-src 'unsafe-inline'; img-src data:; script-src 'sha256-{digest}'"
    return tag(
        "head",
        tag("meta", charset="utf-8"),
        tag("meta", http_equiv="Content-Security-Policy", content=policy),
        tag("meta", name="viewport", content="width=device-width, initial-scale=1"),
        tag("meta", name="color-scheme", content="light dark"),
        tag("title", f"{folder.result.scenario} · avrare"),
        tag("style", Markup(_read_asset("style.css"))),
    )


def _render_header(folder: RunFolder) -> Markup:
    result = folder.result
    description = None if folder.definition is None else folder.definition.description
    estimators = ", ".join(dict.fromkeys(one.estimator for one in result.estimates))
    commit = folder.provenance.commit
    facts = [
        f"estimator {estimators}", f"seed {result.seed}", f"{folder.written:%d %B %Y, %H:%M} UTC",
        f"commit {commit[:10]}" if commit else None,
    ]  # fmt: skip
    return tag(
        "header",
        tag("button", "Theme: auto", id="theme", type="button"),
        tag("h1", result.scenario),
        tag("p", description, class_="description") if description else None,
        tag("p", " · ".join(fact for fact in facts if fact), class_="muted"),
    )


def _render_load_errors(folder: RunFolder) -> Markup | None:
    if folder.scenario is not None:
        return None
    text = "The scenario of this run cannot be built here, so everything that needs it is missing:"
    errors = tag("pre", "\n".join(folder.load_errors))
    return tag("section", tag("p", text), errors, class_="note", role="note")


def _render_provenance(folder: RunFolder) -> Markup:
    result, origin = folder.result, folder.provenance
    commit = origin.commit
    changed = " with uncommitted changes" if origin.uncommitted_changes else ""
    original = "not recorded"
    if origin.command:
        original = shlex.join([Path(origin.command[0]).name, *origin.command[1:]])
    rows = [
        ("fingerprint", tag("code", result.fingerprint)),
        ("commit", tag("code", f"{commit}{changed}") if commit else "none"),
        ("Python", origin.python or "–"),
        ("budget", origin.budget or "the estimator's own options"),
        *result.versions.items(),
    ]
    return tag(
        "section",
        tag("h2", "Provenance"),
        tag("p", "To reproduce the numbers from this run folder:"),
        tag("pre", _format_run_command(folder), class_="command", tabindex=0),
        tag("p", "Original command:"),
        tag("pre", original, class_="command", tabindex=0),
        tag("dl", [tag("div", tag("dt", name), tag("dd", value)) for name, value in rows], class_="origin"),
        tag("details", tag("summary", "Scenario with all defaults"), tag("pre", folder.scenario_text)),
        id="provenance",
    )


def _format_run_command(folder: RunFolder) -> str:
    # scenario.yaml contains the seed, but not the budget.
    budget = folder.provenance.budget
    command = ["avrare", "run", str(folder.path / "scenario.yaml")]
    return shlex.join(command + (["--budget", budget] if budget else []))


def _read_asset(name: str) -> str:
    return files("avrare.report.html").joinpath(name).read_text(encoding="utf-8")
