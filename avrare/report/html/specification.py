"""Section of a report on one specification: the rule, its estimate, causes, charts and rollouts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress

from avrare.base.errors import AvrareError
from avrare.base.number_format import format_percent, format_typeset, format_typeset_interval
from avrare.estimation.loop import prepare_problem
from avrare.estimation.result import Result
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
from avrare.results.run import Run

_PATIENCE = 120.0
"""Predicted time above which the report does not look for the moments at which drives were lost [s]."""
_LONG = 400
"""Words of a formula longer than this are not shown: they say less than the formula."""


def render_sections(run: Run) -> list[Markup]:
    """Return a section for each specification; all stored rollouts are replayed in one batch."""
    estimates = list(run.values())
    selected = [select_rollouts(result, find_stored_kinds(run, result)) for result in estimates]
    rollouts: list[MonitoredRollout] = []
    errors = run.build_errors
    if not errors:
        try:
            rollouts = replay_stored(run.problem, [one for several in selected for one in several])
            if _predict_seconds(estimates, len(rollouts), run.problem.steps) <= _PATIENCE:
                rollouts = with_continuations(run.problem, rollouts)
        except AvrareError as error:
            errors = tuple(error.lines())
    sections = []
    for index, (result, stored) in enumerate(zip(estimates, selected, strict=True)):
        mine = [one for one in rollouts if one.stored.specification == result.specification]
        sections.append(_render_section(run, index, result, mine, errors if stored else ()))
    return sections


def _predict_seconds(estimates: Sequence[Result], shown: int, steps: int) -> float:
    # of all continuations without noise, from the cost of the run's rollouts
    each = max(one.seconds / max(one.rollouts, 1) for one in estimates)
    return each * shown * (steps + 2)


def _render_section(
    run: Run, index: int, result: Result, rollouts: Sequence[MonitoredRollout],
    errors: Sequence[str],
) -> Markup:  # fmt: skip
    head = tag("div", tag("h2", result.specification), render_badge(result.verdict), class_="head")
    return tag(
        "section", head, _render_formula(run, result.specification), _render_facts(result),
        _render_warnings(result), render_causes(run, result, rollouts), _draw_charts(run, result),
        _render_players(run, rollouts, errors),
        id=f"specification-{index}", class_="specification",
    )  # fmt: skip


def _render_formula(run: Run, name: str) -> Markup | None:
    if run.build_errors or name not in run.problem.names:
        return None
    specification = run.problem.monitor(name)
    formula, saying = find_formula(specification), find_ability(specification, HasWords)
    words = saying.words if saying is not None else ""
    if formula is not None and not words:
        words = to_words(formula.node, float(formula.dt))
    shown = None if formula is None else tag("pre", formula.text.strip(), class_="formula", tabindex=0)
    if len(words) > _LONG:  # longer than it helps
        return shown
    inside = tag("details", tag("summary", "As a formula"), shown, class_="plain") if shown else None
    return tag("div", tag("p", words, class_="rule"), inside)


def _render_facts(result: Result) -> Markup:
    error = result.relative_error
    facts = [
        ("probability", format_typeset(result.probability)),
        (f"{format_percent(result.confidence)} interval", format_typeset_interval(result.interval)),
        ("relative error", "–" if error is None else format_percent(round(error, 3))),
        ("rollouts", f"{result.rollouts:,}"),
        ("failures", f"{result.failures.count:,}"),
        ("errors", f"{result.errors:,}"),
        ("time", f"{result.seconds:,.1f} s"),
    ]
    rows = [tag("div", tag("dt", name), tag("dd", value)) for name, value in facts]
    rows.append(tag("div", tag("dt", "made by"), tag("dd", link_command("run"))))
    notes = [tag("p", note.text, class_="muted") for note in result.notes]
    return tag("div", tag("dl", rows, class_="facts"), notes)


def _render_warnings(result: Result) -> Markup:
    if not result.health:
        return tag("div", tag("p", "No warnings."), class_="health")
    lines = [
        tag("li", tag("strong", name.replace("_", " ")), f": {text}.") for name, text in result.health.items()
    ]
    return tag("div", tag("h3", "Warnings"), tag("ul", lines), class_="health warning", role="note")


def _draw_charts(run: Run, result: Result) -> Markup:
    robustness = result.robustness
    diagnostics = result.diagnostics
    splitting = bool(diagnostics.get("levels"))
    histogram = charts.draw_histogram(robustness, splitting)
    pair = tag("div", histogram, charts.draw_convergence(result, robustness), class_="pair")
    gamma, label = _find_gamma(run, result) if splitting else (float, "")
    return tag("div", pair, charts.draw_levels(diagnostics, gamma, label))


def _find_gamma(run: Run, result: Result) -> tuple[Callable[[float], float], str]:
    # the map from levels of the score to robustness thresholds γ, if it is known, and its label
    with suppress(AvrareError):  # the label says that the axis is the score
        origin = result.require_origin()
        return prepare_problem(origin.estimator, origin.problem).gamma, "γ, 0 at failure"
    return float, "score"


def _render_players(run: Run, rollouts: Sequence[MonitoredRollout], errors: Sequence[str]) -> Markup:
    if run.build_errors:
        text = "The stored rollouts are not shown: the scenario cannot be built here."
        return tag("p", text, class_="muted")
    if errors:
        text = "The stored rollouts could not be replayed:"
        return tag("div", tag("p", text), tag("pre", "\n".join(errors)), class_="note")
    if not rollouts:
        return tag("p", "No rollout is stored in the run folder.", class_="muted")
    players = [render_player(rollout, run.problem, k == 0, run.folder) for k, rollout in enumerate(rollouts)]
    return tag("div", players)
