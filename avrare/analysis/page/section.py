"""Section on one specification: the rule, its estimate, causes, charts and rollouts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress

from avrare.analysis.page import estimate_charts as charts
from avrare.analysis.page.causes import build_causes
from avrare.analysis.page.model import Estimate, Notice, Rule, Section
from avrare.analysis.page.player import build_player
from avrare.analysis.page.stored_rollouts import replay_stored
from avrare.base.chart import Chart
from avrare.base.errors import AvrareError
from avrare.estimation.loop.preflight import prepare_problem
from avrare.estimation.result.result import Result
from avrare.logic.formula import find_formula
from avrare.logic.syntax.words import HasWords, to_words
from avrare.protocols import find_ability
from avrare.results.run import Run
from avrare.results.stored_causes import read_causes

_LONG = 400
"""Words of a formula longer than this are not shown: they say less than the formula."""


def build_sections(run: Run, estimates: Sequence[Estimate]) -> tuple[Section, ...]:
    """Return a section for each estimate of a run."""
    stored = read_causes(run.folder, {name: result.probability for name, result in run.items()})
    rollouts, errors = replay_stored(run, stored.kinds)
    sections = []
    for estimate in estimates:
        name = estimate.specification
        result, shown = run[name], rollouts.get(name, [])
        section = Section(
            estimate,
            _build_rule(run, name),
            build_causes(run, result, stored, shown),
            _draw_convergence(result),
            _draw_levels(result),
            tuple(build_player(rollout, run.problem, run.folder) for rollout in shown),
            None if shown else _explain_absence(run, errors if name in rollouts else ()),
        )
        sections.append(section)
    return tuple(sections)


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


def _draw_convergence(result: Result) -> tuple[Chart, ...]:
    histogram = charts.draw_histogram(result.robustness, bool(result.diagnostics.get("levels")))
    drawn = (histogram, charts.draw_convergence(result, result.robustness))
    return tuple(chart for chart in drawn if chart is not None)


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
