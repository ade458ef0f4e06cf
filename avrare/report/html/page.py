"""The report: one HTML file with its style, its script and its data, and nothing from anywhere else."""

from __future__ import annotations

import base64
import hashlib
import shlex
from importlib.resources import files
from pathlib import Path
from typing import Any

from avrare.report.html.estimates import hero, table
from avrare.report.html.folder import RunFolder, read_folder
from avrare.report.html.markup import Markup, tag
from avrare.report.html.rules import sections


def report(path: Path) -> str:
    """The report of a run's folder as HTML.

    Raises:
        UsageError: It is no run's folder, or its files are damaged.
    """
    return page(read_folder(path))


def page(folder: RunFolder) -> str:
    """The report of a folder that has been read."""
    script = _asset("script.js")
    body = tag(
        "body",
        tag("a", "To the estimates", href="#estimates", class_="skip"),
        _header(folder),
        tag("main", hero(folder), table(folder), _trouble(folder), sections(folder), _provenance(folder)),
        tag("footer", f"Made by avrare {folder.result['versions'].get('avrare', '')}"),
        tag("script", Markup(script)),
    )
    return "<!doctype html>\n" + tag("html", _head(folder, script), body, lang="en") + "\n"


def _head(folder: RunFolder, script: str) -> Markup:
    """With a policy under which only this script runs, and nothing is loaded."""
    known = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    policy = f"default-src 'none'; style-src 'unsafe-inline'; img-src data:; script-src 'sha256-{known}'"
    return tag(
        "head",
        tag("meta", charset="utf-8"),
        tag("meta", http_equiv="Content-Security-Policy", content=policy),
        tag("meta", name="viewport", content="width=device-width, initial-scale=1"),
        tag("meta", name="color-scheme", content="light dark"),
        tag("title", f"{folder.name} · avrare"),
        tag("style", Markup(_asset("style.css"))),
    )


def _header(folder: RunFolder) -> Markup:
    result = folder.result
    description = None if folder.definition is None else folder.definition.description
    estimators = ", ".join(dict.fromkeys(one["estimator"] for one in folder.estimates))
    commit = folder.provenance.get("commit")
    facts = [
        f"estimator {estimators}", f"seed {result['seed']}", f"{folder.written:%d %B %Y, %H:%M} UTC",
        f"commit {commit[:10]}" if commit else None,
    ]  # fmt: skip
    return tag(
        "header",
        tag("button", "Theme: auto", id="theme", type="button"),
        tag("h1", folder.name),
        tag("p", description, class_="description") if description else None,
        tag("p", " · ".join(fact for fact in facts if fact), class_="muted"),
    )


def _trouble(folder: RunFolder) -> Markup | None:
    if folder.scenario is not None:
        return None
    text = "The scenario of this folder cannot be built here; what needs it is left out:"
    return tag("section", tag("p", text), tag("pre", "\n".join(folder.trouble)), class_="note", role="note")


def _provenance(folder: RunFolder) -> Markup:
    result, origin = folder.result, folder.provenance
    commit = origin.get("commit")
    changed = " with uncommitted changes" if origin.get("uncommitted_changes") else ""
    rows = [
        ("fingerprint", tag("code", result["fingerprint"])),
        ("commit", tag("code", f"{commit}{changed}") if commit else "none"),
        ("Python", origin.get("python", "–")),
        ("budget", origin.get("budget") or "the estimator's own options"),
        *((name, version) for name, version in result["versions"].items()),
    ]
    return tag(
        "section",
        tag("h2", "Where this comes from"),
        tag("p", "The same numbers again, from the folder of this run:"),
        tag("pre", _again(folder), class_="command", tabindex=0),
        tag("p", "As it was called:"),
        tag("pre", _called(origin), class_="command", tabindex=0),
        tag("dl", [tag("div", tag("dt", name), tag("dd", value)) for name, value in rows], class_="origin"),
        tag("details", tag("summary", "The scenario, with every default"), tag("pre", folder.text)),
        id="provenance",
    )


def _again(folder: RunFolder) -> str:
    """The seed is in the scenario's file; the budget is not."""
    budget = folder.provenance.get("budget")
    words = ["avrare", "run", str(folder.path / "scenario.yaml")]
    return shlex.join(words + (["--budget", str(budget)] if budget else []))


def _called(origin: dict[str, Any]) -> str:
    words = [str(word) for word in origin.get("command") or []]
    return shlex.join([Path(words[0]).name, *words[1:]]) if words else "not recorded"


def _asset(name: str) -> str:
    return files("avrare.report.html").joinpath(name).read_text(encoding="utf-8")
