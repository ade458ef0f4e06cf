"""Section of each specification: estimate, warnings, charts and shown rollouts."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from avrare.base.errors import AvrareError
from avrare.base.format import describe_blind_bound, format_percent, format_typeset, format_typeset_interval
from avrare.estimation.loop import prepare_problem
from avrare.logic.formula import find_formula
from avrare.report.html import charts
from avrare.report.html.estimate_table import render_badge
from avrare.report.html.markup import Markup, tag
from avrare.report.html.replayed_rollouts import (
    MonitoredRollout,
    StoredRollout,
    replay_stored,
    select_rollouts,
)
from avrare.report.html.rollout_player import render_player
from avrare.results.reader import RunFolder, StoredEstimate


def render_sections(folder: RunFolder) -> list[Markup]:
    """Return a section for each estimate, in the order of result.json."""
    names = [one.specification for one in folder.result.estimates]
    selected = {
        name: select_rollouts(name, folder.failures.get(name), folder.samples.get(name)) for name in names
    }
    rollouts, errors = _replay(folder, [one for several in selected.values() for one in several])
    sections = []
    for index, (name, entry) in enumerate(zip(names, folder.result.estimates, strict=True)):
        mine = [one for one in rollouts if one.stored.specification == name]
        shown = _render_players(folder, mine, errors if selected[name] else ())
        sections.append(_render_section(folder, index, entry, shown))
    return sections


def _replay(
    folder: RunFolder, stored: Sequence[StoredRollout]
) -> tuple[list[MonitoredRollout], tuple[str, ...]]:
    if folder.scenario is None:
        return [], folder.load_errors
    try:
        return replay_stored(folder.scenario, stored), ()
    except AvrareError as error:
        return [], tuple(error.lines())


def _render_section(folder: RunFolder, index: int, entry: StoredEstimate, rollouts: Markup) -> Markup:
    head = tag("div", tag("h2", entry.specification), render_badge(entry.verdict), class_="head")
    return tag(
        "section", head, _render_formula(folder, entry.specification), _render_facts(entry),
        _render_warnings(entry), _draw_charts(folder, entry), rollouts,
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
    bound = entry.blind_bound
    sentence = "" if bound is None else f"{describe_blind_bound(bound).capitalize()}."
    return tag(
        "div", tag("dl", rows, class_="facts"), tag("p", sentence, class_="muted") if sentence else None
    )


def _render_warnings(entry: StoredEstimate) -> Markup:
    warnings = entry.warnings or {}
    lines = [
        tag("li", tag("strong", name.replace("_", " ")), f": {text}.") for name, text in warnings.items()
    ]
    counts = entry.counts or {}
    solves = counts.get("solves", 0)
    for name, count in counts.items():
        if count and name != "solves":
            lines.append(tag("li", f"{name.replace('_', ' ')}: {count:,} of {solves:,}."))
    if warnings:
        return tag("div", tag("h3", "Warnings"), tag("ul", lines), class_="health warning", role="note")
    return tag("div", tag("p", "No warnings."), tag("ul", lines) if lines else None, class_="health")


def _draw_charts(folder: RunFolder, entry: StoredEstimate) -> Markup | None:
    sample = folder.samples.get(entry.specification)
    robustness = np.zeros(0) if sample is None else sample.robustness.astype(np.float64)
    diagnostics = entry.diagnostics or {}
    splitting = bool(diagnostics.get("levels"))
    figures = [charts.draw_histogram(robustness, splitting), charts.draw_convergence(entry, robustness)]
    gamma, label = _find_gamma(folder, entry) if splitting else (float, "")
    pair = tag("div", [one for one in figures if one is not None], class_="pair")
    return tag("div", pair, charts.draw_levels(diagnostics, gamma, label))


def _find_gamma(folder: RunFolder, entry: StoredEstimate) -> tuple[Callable[[float], float], str]:
    # the map from levels of the score to robustness thresholds γ, if it is known, and its label
    score = float, "score"
    if folder.scenario is None:
        return score
    try:
        problem, estimator = folder.scenario.problem(entry.specification), folder.scenario.estimator()
        return prepare_problem(estimator, problem).gamma, "γ, 0 at failure"
    except AvrareError:  # the label says that the axis is the score
        return score


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
