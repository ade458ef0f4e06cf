"""Section of a report on one specification: the rule, its estimate, causes, charts and rollouts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress

import numpy as np

from avrare.base.errors import AvrareError
from avrare.base.number_format import format_percent, format_typeset, format_typeset_interval
from avrare.estimation.loop import prepare_problem
from avrare.logic.formula import find_formula
from avrare.logic.syntax.words import HasWords, to_words
from avrare.protocols import find_ability
from avrare.report.html import charts
from avrare.report.html.causes import find_stored_kinds, render_causes
from avrare.report.html.markup import Markup, link_command, tag
from avrare.report.html.rollout_player import render_player
from avrare.report.html.stored_rollouts import (
    MonitoredRollout,
    replay_stored,
    select_rollouts,
    with_continuations,
)
from avrare.report.html.verdict import render_badge
from avrare.results.reader import RunFolder, StoredEstimate

_PATIENCE = 120.0
"""Predicted time above which the report does not look for the moments at which drives were lost [s]."""
_LONG = 400
"""Words of a formula longer than this are not shown: they say less than the formula."""


def render_sections(folder: RunFolder) -> list[Markup]:
    """Return a section for each specification; all stored rollouts are replayed in one batch."""
    estimates = folder.result.estimates
    selected = [
        select_rollouts(
            name, folder.failures.get(name), folder.samples.get(name), find_stored_kinds(folder, one)
        )
        for one in estimates
        for name in [one.specification]
    ]
    rollouts: list[MonitoredRollout] = []
    errors = folder.load_errors
    if folder.scenario is not None:
        try:
            problem = folder.scenario.problem(folder.scenario.specifications)
            rollouts = replay_stored(problem, [one for several in selected for one in several])
            if _predict_seconds(estimates, len(rollouts), problem.steps) <= _PATIENCE:
                rollouts = with_continuations(problem, rollouts)
        except AvrareError as error:
            errors = tuple(error.lines())
    sections = []
    for index, (entry, stored) in enumerate(zip(estimates, selected, strict=True)):
        mine = [one for one in rollouts if one.stored.specification == entry.specification]
        sections.append(_render_section(folder, index, entry, mine, errors if stored else ()))
    return sections


def _predict_seconds(estimates: Sequence[StoredEstimate], shown: int, steps: int) -> float:
    # of all continuations without noise, from the cost of the run's rollouts
    each = max(one.seconds / max(one.rollouts, 1) for one in estimates)
    return each * shown * (steps + 2)


def _render_section(
    folder: RunFolder, index: int, entry: StoredEstimate, rollouts: Sequence[MonitoredRollout],
    errors: Sequence[str],
) -> Markup:  # fmt: skip
    head = tag("div", tag("h2", entry.specification), render_badge(entry.verdict), class_="head")
    return tag(
        "section", head, _render_formula(folder, entry.specification), _render_facts(entry),
        _render_warnings(entry), render_causes(folder, entry, rollouts), _draw_charts(folder, entry),
        _render_players(folder, rollouts, errors),
        id=f"specification-{index}", class_="specification",
    )  # fmt: skip


def _render_formula(folder: RunFolder, name: str) -> Markup | None:
    if folder.scenario is None:
        return None
    specification = folder.scenario.stack.specifications.get(name)
    formula, saying = find_formula(specification), find_ability(specification, HasWords)
    words = saying.words if saying is not None else ""
    if formula is not None and not words:
        words = to_words(formula.node, float(formula.dt))
    shown = None if formula is None else tag("pre", formula.text.strip(), class_="formula", tabindex=0)
    if len(words) > _LONG:  # longer than it helps
        return shown
    inside = tag("details", tag("summary", "As a formula"), shown, class_="plain") if shown else None
    return tag("div", tag("p", words, class_="rule"), inside)


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
    rows.append(tag("div", tag("dt", "made by"), tag("dd", link_command("run"))))
    notes = [tag("p", note.text, class_="muted") for note in entry.notes]
    return tag("div", tag("dl", rows, class_="facts"), notes)


def _render_warnings(entry: StoredEstimate) -> Markup:
    if not entry.warnings:
        return tag("div", tag("p", "No warnings."), class_="health")
    lines = [
        tag("li", tag("strong", name.replace("_", " ")), f": {text}.")
        for name, text in entry.warnings.items()
    ]
    return tag("div", tag("h3", "Warnings"), tag("ul", lines), class_="health warning", role="note")


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
    path = folder.path if (folder.path / "result.json").is_file() else None  # a run in Python has none
    problem = folder.scenario.problem(folder.scenario.specifications)
    return tag("div", [render_player(one, problem, k == 0, path) for k, one in enumerate(rollouts)])
