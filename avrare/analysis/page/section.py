"""Section on one specification: the rule, its estimate, causes, charts and rollouts."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import suppress

from avrare.analysis.page import estimate_charts as charts
from avrare.analysis.page.causes import build_causes, find_stored_kinds
from avrare.analysis.page.model import Estimate, Limit, Notice, Rule, Section
from avrare.analysis.page.player import build_player
from avrare.analysis.page.stored_rollouts import (
    MonitoredRollout,
    replay_stored,
    select_rollouts,
    with_continuations,
)
from avrare.base.chart import Chart
from avrare.base.errors import AvrareError
from avrare.estimation.loop import prepare_problem
from avrare.estimation.result import Result
from avrare.logic.formula import find_formula
from avrare.logic.syntax.words import HasWords, to_words
from avrare.protocols import find_ability
from avrare.results.run import Run

_PATIENCE = 120.0
"""Predicted time above which the report does not look for the moments at which drives were lost [s]."""
_LONG = 400
"""Words of a formula longer than this are not shown: they say less than the formula."""


def build_sections(run: Run) -> tuple[Section, ...]:
    """Return a section for each specification; all stored rollouts are replayed in one batch."""
    estimates = list(run.values())
    selected = [select_rollouts(result, find_stored_kinds(run, result)) for result in estimates]
    rollouts: list[MonitoredRollout] = []
    errors = run.build_errors
    if not errors:
        try:
            rollouts = replay_stored(run.problem, [stored for several in selected for stored in several])
            if _predict_seconds(estimates, len(rollouts), run.problem.steps) <= _PATIENCE:
                rollouts = with_continuations(run.problem, rollouts)
        except AvrareError as error:
            errors = tuple(error.lines())
    sections = []
    for result, stored in zip(estimates, selected, strict=True):
        shown = [rollout for rollout in rollouts if rollout.stored.specification == result.specification]
        sections.append(_build_section(run, result, shown, errors if stored else ()))
    return tuple(sections)


def _predict_seconds(estimates: Sequence[Result], shown: int, steps: int) -> float:
    # of all continuations without noise, from the cost of the run's rollouts
    each = max(one.seconds / max(one.rollouts, 1) for one in estimates)
    return each * shown * (steps + 2)


def _build_section(
    run: Run, result: Result, rollouts: Sequence[MonitoredRollout], errors: Sequence[str]
) -> Section:
    return Section(
        _build_estimate(run, result),
        _build_rule(run, result.specification),
        build_causes(run, result, rollouts),
        _draw_convergence(result),
        _draw_levels(result),
        tuple(build_player(rollout, run.problem, run.folder) for rollout in rollouts),
        _explain_absence(run, errors) if not rollouts else None,
    )


def _build_rule(run: Run, name: str) -> Rule | None:
    if run.build_errors or name not in run.problem.names:
        return None
    specification = run.problem.monitor(name)
    formula, saying = find_formula(specification), find_ability(specification, HasWords)
    words = saying.words if saying is not None else ""
    if formula is not None and not words:
        words = to_words(formula.node, float(formula.dt))
    text = "" if formula is None else formula.text.strip()
    return Rule("" if len(words) > _LONG else words, text)


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
    )


def _draw_convergence(result: Result) -> tuple[Chart, ...]:
    histogram = charts.draw_histogram(result.robustness, bool(result.diagnostics.get("levels")))
    found = (histogram, charts.draw_convergence(result, result.robustness))
    return tuple(chart for chart in found if chart is not None)


def _draw_levels(result: Result) -> tuple[Chart, ...]:
    if not result.diagnostics.get("levels"):
        return ()
    return charts.draw_levels(result.diagnostics, *_find_gamma(result))


def _find_gamma(result: Result) -> tuple[Callable[[float], float], str]:
    # the map from levels of the score to robustness thresholds γ, if it is known, and its label
    with suppress(AvrareError):  # the label says that the axis is the score
        origin = result.require_origin()
        return prepare_problem(origin.estimator, origin.problem).gamma, "γ, 0 at failure"
    return float, "score"


def _explain_absence(run: Run, errors: Sequence[str]) -> Notice:
    if run.build_errors:
        return Notice("The stored rollouts are not shown: the scenario cannot be built here.")
    if errors:
        return Notice("The stored rollouts could not be replayed:", tuple(errors))
    return Notice("No rollout is stored in the run folder.")
