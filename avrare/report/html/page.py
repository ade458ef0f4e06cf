"""HTML report of a run folder: one self-contained file with style, script and data."""

from __future__ import annotations

import base64
import hashlib
import shlex
from collections.abc import Callable, Sequence
from contextlib import suppress
from importlib.resources import files
from pathlib import Path

import numpy as np

from avrare.base.errors import AvrareError
from avrare.base.number_format import (
    describe_blind_bound,
    format_amount_in_words,
    format_percent,
    format_typeset,
    format_typeset_interval,
)
from avrare.estimation.loop import prepare_problem
from avrare.estimation.result import worst_verdict
from avrare.logic.formula import find_formula
from avrare.report.html import charts
from avrare.report.html.causes import render_causes
from avrare.report.html.line_chart import Scale, make_log_scale
from avrare.report.html.markup import Markup, tag
from avrare.report.html.rollout_player import MonitoredRollout, render_player, replay_stored, select_rollouts
from avrare.results.reader import RunFolder, StoredEstimate, read_run_folder

_VERDICTS = {"pass": "Passes", "fail": "Fails", "inconclusive": "Inconclusive", None: "No threshold"}
_SIGNS = {"pass": "✓", "fail": "✕", "inconclusive": "?", None: "–"}
_RARE = 0.1  # a smaller probability is written as one in so many
_SENTENCES = {
    None: "No threshold is set, so there is no verdict.",
    "pass": "Every threshold is met: the whole interval lies below the threshold for {}.",
    "fail": "The whole interval lies above the threshold for {}.",
    "inconclusive": "The interval contains the threshold for {}: more rollouts are needed for a verdict.",
}


def render_report(path: Path) -> str:
    """Return the report of a run folder as HTML."""
    return render_folder(read_run_folder(path))


def render_folder(folder: RunFolder) -> str:
    """Return the report of the content of a run folder as HTML."""
    script = _read_asset("script.js")
    sections = [*_render_sections(folder), _render_provenance(folder)]
    body = tag(
        "body",
        tag("a", "To the estimates", href="#estimates", class_="skip"),
        _render_header(folder),
        tag("main", _render_verdict(folder), _render_estimates(folder), _render_errors(folder), sections),
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


def _render_errors(folder: RunFolder) -> list[Markup]:
    found = []
    if folder.scenario is None:
        text = "The scenario of this run cannot be built here, so everything that needs it is missing:"
        found.append((text, folder.load_errors))
    if folder.changes:
        found.append(("What is shown of the scenario may not be what was run:", folder.changes))
    return [
        tag("section", tag("p", text), tag("pre", "\n".join(lines)), class_="note", role="note")
        for text, lines in found
    ]


def _render_provenance(folder: RunFolder) -> Markup:
    result, origin = folder.result, folder.provenance
    commit = origin.commit
    changed = " with uncommitted changes" if origin.uncommitted_changes else ""
    original = shlex.join([Path(origin.command[0]).name, *origin.command[1:]]) if origin.command else ""
    rows = [
        ("fingerprint", tag("code", result.fingerprint)) if result.fingerprint else None,
        ("commit", tag("code", f"{commit}{changed}") if commit else "none"),
        ("Python", origin.python or "–"),
        ("budget", origin.budget or "the estimator's own options"),
        *result.versions.items(),
    ]
    return tag(
        "section",
        tag("h2", "Provenance"),
        tag("p", "To reproduce the numbers:"),
        tag("pre", folder.reproduction, class_="command", tabindex=0),
        tag("p", "Original command:") if original else None,
        tag("pre", original, class_="command", tabindex=0) if original else None,
        tag("dl", [tag("div", tag("dt", row[0]), tag("dd", row[1])) for row in rows if row], class_="origin"),
        tag("details", tag("summary", "Scenario with all defaults"), tag("pre", folder.scenario_text))
        if folder.scenario_text
        else None,
        id="provenance",
    )


def _read_asset(name: str) -> str:
    return files("avrare.report.html").joinpath(name).read_text(encoding="utf-8")


def _render_badge(verdict: str | None) -> Markup:
    """Return a verdict as a word with a sign, so that it does not depend on colour alone."""
    sign = tag("span", _SIGNS[verdict], aria_hidden="true")
    return tag("span", sign, f" {_VERDICTS[verdict]}", class_=f"badge {verdict or 'none'}")


def _render_verdict(folder: RunFolder) -> Markup:
    """Return the section with the overall verdict."""
    verdict = worst_verdict(one.verdict for one in folder.result.estimates)
    judged = [one for one in folder.result.estimates if one.verdict]
    passed = sum(one.verdict == "pass" for one in judged)
    count = len(folder.result.estimates)
    met = f"{passed} of {len(judged)} thresholds met, " if judged else ""
    noun = "specification" if count == 1 else "specifications"
    failing = sum(one.failures > 0 for one in folder.result.estimates)
    text = f"{met}{count} {noun} estimated, {failing} with failures.{_describe_most_frequent(folder)}"
    return tag(
        "section", tag("div", _render_badge(verdict), class_="verdict"),
        tag("p", _explain_verdict(folder.result.estimates, verdict), class_="lead"),
        tag("p", text, class_="muted"),
        class_="summary", aria_label="Verdict",
    )  # fmt: skip


def _explain_verdict(estimates: Sequence[StoredEstimate], verdict: str | None) -> str:
    *names, last = (one.specification for one in estimates if one.verdict == verdict)
    return _SENTENCES[verdict].format(f"{', '.join(names)} and {last}" if names else last)


def _describe_most_frequent(folder: RunFolder) -> str:
    most = max(folder.result.estimates, key=lambda one: one.probability)
    p = most.probability
    if p <= 0.0:
        return ""
    often = " most often," if len(folder.result.estimates) > 1 else ""
    share = f"{format_percent(float(f'{p:.2g}'))} of all rollouts"
    if p < _RARE:
        share = f"about one in {format_amount_in_words(1.0 / p)} rollouts"
    return f" {most.specification} is violated{often} in {share}."


def _render_estimates(folder: RunFolder) -> Markup:
    """Return the table with a row for each specification."""
    scale = _make_axis(folder)
    heads = ("Specification", "Probability", "", "Rollouts", "Failures", "Errors", "Verdict")
    kinds = ("", "number", "bars", "number", "number", "number", "")
    marks = [tag("span", word, style=f"left:{scale.at(value)}%") for value, word in scale.ticks()]
    ticks = tag("div", marks, class_="bar-ticks")
    row = [
        tag("th", ticks if kind == "bars" else head, scope="col", class_=kind or None)
        for head, kind in zip(heads, kinds, strict=True)
    ]
    body = [_render_row(folder, index, entry, scale) for index, entry in enumerate(folder.result.estimates)]
    confidence = folder.result.estimates[0].confidence
    note = (
        f"Probability that a rollout violates the specification. Bars: {format_percent(confidence)} "
        "intervals on a logarithmic axis; ticks: thresholds."
    )
    return tag(
        "section", tag("h2", "Estimates"), tag("p", note, class_="muted"),
        tag("div", tag("table", tag("thead", tag("tr", row)), tag("tbody", body), class_="estimates")),
        id="estimates",
    )  # fmt: skip


def _render_row(folder: RunFolder, index: int, entry: StoredEstimate, scale: Scale) -> Markup:
    name = tag("a", _allow_breaks(entry.specification), href=f"#specification-{index}")
    value = [
        tag("strong", format_typeset(entry.probability)),
        tag("span", format_typeset_interval(entry.interval), class_="interval"),
    ]
    thresholds = folder.thresholds(entry.specification)
    bounds = [
        tag("span", f"{'<' if one.strict else '≤'} {format_typeset(one.limit)}", class_="bound")
        for one in thresholds
    ]
    cells = (
        ("Probability", "number", value),
        (None, "bars", _draw_bar(entry, scale, [one.limit for one in thresholds])),
        ("Rollouts", "number", f"{entry.rollouts:,}"),
        ("Failures", "number", f"{entry.failures:,}"),
        ("Errors", "number", f"{entry.errors:,}"),
        ("Verdict", "", [_render_badge(entry.verdict), bounds]),
    )
    return tag(
        "tr", tag("th", name, scope="row"),
        [tag("td", content, class_=kind or None, data_label=label) for label, kind, content in cells],
    )  # fmt: skip


def _draw_bar(entry: StoredEstimate, scale: Scale, limits: Sequence[float]) -> Markup:
    low, high = entry.interval
    probability = entry.probability
    begin, end = (scale.at(low) if low > 0.0 else 0.0), scale.at(high)
    ends = f"from {format_typeset(low, 2)} to {format_typeset(high, 2)}"
    words = f"interval {ends}, estimate {format_typeset(probability)}"
    marks = [tag("i", class_="limit", style=f"left:{scale.at(limit)}%") for limit in limits]
    dot = tag("i", class_="point", style=f"left:{scale.at(probability)}%") if probability > 0.0 else None
    style = f"left:{begin}%;width:{max(end - begin, 0.6):.2f}%"
    grid = [tag("i", class_="tick", style=f"left:{scale.at(v)}%") for v, _ in scale.ticks()]
    return tag(
        "div", grid, tag("i", class_="span open" if low <= 0.0 else "span", style=style), marks, dot,
        class_="bar-cell", role="img", aria_label=words,
    )  # fmt: skip


def _make_axis(folder: RunFolder) -> Scale:
    # An interval from 0 gets a decade of its own.
    values: list[float] = []
    for entry in folder.result.estimates:
        low, high = entry.interval
        values += [low, high, entry.probability]
        values += [one.limit for one in folder.thresholds(entry.specification)]
        values += [high / 10.0] if low <= 0.0 else []
    return make_log_scale(values, most=1.0)


def _allow_breaks(name: str) -> list[Markup | str]:
    first, *rest = name.split("_")
    return [first, *(part for word in rest for part in ("_", tag("wbr"), word))]


def _render_sections(folder: RunFolder) -> list[Markup]:
    names = [one.specification for one in folder.result.estimates]
    selected = [select_rollouts(name, folder.failures.get(name), folder.samples.get(name)) for name in names]
    rollouts: list[MonitoredRollout] = []
    errors = folder.load_errors
    if folder.scenario is not None:
        try:
            rollouts = replay_stored(folder.scenario, [one for several in selected for one in several])
        except AvrareError as error:
            errors = tuple(error.lines())
    sections = []
    for index, (entry, stored) in enumerate(zip(folder.result.estimates, selected, strict=True)):
        mine = [one for one in rollouts if one.stored.specification == entry.specification]
        shown = _render_players(folder, mine, errors if stored else ())
        sections.append(_render_section(folder, index, entry, shown))
    return sections


def _render_section(folder: RunFolder, index: int, entry: StoredEstimate, rollouts: Markup) -> Markup:
    head = tag("div", tag("h2", entry.specification), _render_badge(entry.verdict), class_="head")
    return tag(
        "section", head, _render_formula(folder, entry.specification), _render_facts(entry),
        _render_warnings(entry), render_causes(folder, entry), _draw_charts(folder, entry), rollouts,
        id=f"specification-{index}", class_="specification",
    )  # fmt: skip


def _render_formula(folder: RunFolder, name: str) -> Markup | None:
    if folder.scenario is None:
        return None
    formula = find_formula(folder.scenario.stack.specifications.get(name))
    return None if formula is None else tag("pre", formula.text.strip(), class_="formula", tabindex=0)


def _render_facts(entry: StoredEstimate) -> Markup:
    error = entry.relative_error
    facts = [
        ("probability", format_typeset(entry.probability)),
        (f"{format_percent(entry.confidence)} interval", format_typeset_interval(entry.interval)),
        ("relative error", "–" if error is None else format_percent(round(error, 3))),
        ("rollouts", f"{entry.rollouts:,}"),
        ("failures", f"{entry.failures:,}"),
        ("errors", f"{entry.errors:,}"),
        ("time", f"{entry.seconds:,.1f} s"),
    ]
    rows = [tag("div", tag("dt", name), tag("dd", value)) for name, value in facts]
    notes = [] if entry.blind_bound is None else [describe_blind_bound(entry.blind_bound)]
    if check := entry.cross_check:
        notes.append(f"{check.text} ({check.rollouts:,} rollouts, {check.seconds:,.1f} s)")
    diagnostics = entry.diagnostics or {}
    notes += [diagnostics["choice"]["text"]] if "choice" in diagnostics else []
    notes += [cause["text"] for cause in diagnostics.get("learnt", ())]
    shown = [tag("p", f"{note[0].upper()}{note[1:]}.", class_="muted") for note in notes]
    return tag("div", tag("dl", rows, class_="facts"), shown)


def _render_warnings(entry: StoredEstimate) -> Markup:
    warnings = entry.warnings or {}
    lines = [
        tag("li", tag("strong", name.replace("_", " ")), f": {text}.") for name, text in warnings.items()
    ]
    counts = entry.counts or {}
    solves = counts.get("solves", 0)
    for name, count in counts.items():
        if count and name != "solves":
            total = f" of {solves:,}" if "solve" in name else ""
            lines.append(tag("li", f"{name.replace('_', ' ')}: {count:,}{total}."))
    if warnings:
        return tag("div", tag("h3", "Warnings"), tag("ul", lines), class_="health warning", role="note")
    return tag("div", tag("p", "No warnings."), tag("ul", lines) if lines else None, class_="health")


def _draw_charts(folder: RunFolder, entry: StoredEstimate) -> Markup:
    sample = folder.samples.get(entry.specification)
    robustness = np.zeros(0) if sample is None else sample.robustness.astype(np.float64)
    diagnostics = entry.diagnostics or {}
    splitting = bool(diagnostics.get("levels"))
    histogram = charts.draw_histogram(robustness, splitting)
    pair = tag("div", histogram, charts.draw_convergence(entry, robustness), class_="pair")
    gamma, label = _find_gamma(folder, entry) if splitting else (float, "")
    return tag("div", pair, charts.draw_levels(diagnostics, gamma, label))


def _find_gamma(folder: RunFolder, entry: StoredEstimate) -> tuple[Callable[[float], float], str]:
    # the map from levels of the score to robustness thresholds γ, if it is known, and its label
    if folder.scenario is not None:
        with suppress(AvrareError):  # the label says that the axis is the score
            problem = folder.scenario.problem(entry.specification)
            estimator = folder.estimator(entry.specification)
            return prepare_problem(estimator, problem).gamma, "γ, 0 at failure"
    return float, "score"


def _render_players(folder: RunFolder, rollouts: Sequence[MonitoredRollout], errors: Sequence[str]) -> Markup:
    if folder.scenario is None and errors:
        text = "The stored rollouts are not shown: the scenario cannot be built here."
        return tag("p", text, class_="muted")
    if errors:
        text = "The stored rollouts could not be replayed:"
        return tag("div", tag("p", text), tag("pre", "\n".join(errors)), class_="note")
    if folder.scenario is None or not rollouts:
        return tag("p", "No rollout is stored in the run folder.", class_="muted")
    return tag("div", [render_player(one, folder.scenario, k == 0) for k, one in enumerate(rollouts)])
