"""Model of the page of a catalogue's rates."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import zip_longest

from avrare.analysis.page.rates_model import Rate, RatesModel, Table
from avrare.analysis.rates.combination import Total
from avrare.analysis.rates.rates import BROKEN, CatalogueRates, RuleRate
from avrare.analysis.rates.scene_estimates import SceneEstimate
from avrare.analysis.rates.sentences import (
    describe_blind,
    describe_grid,
    describe_scenes,
    describe_warnings,
    list_scenes,
)
from avrare.base.chart import Scale, make_log_scale
from avrare.base.number_format import (
    format_count,
    format_percent,
    format_typeset,
    format_typeset_interval,
)


def build_rates(rates: CatalogueRates) -> RatesModel:
    """Return everything that the page of a catalogue shows."""
    document = rates.catalogue.document
    totals: dict[str, list[Total]] = {}
    rows = list(_list_rates(rates))
    for *_, unit, total in rows:
        totals.setdefault(unit, []).append(total)
    broken = f"{BROKEN[0].upper()}{BROKEN[1:]}: {', '.join(rates.errors)}."
    notices = ((broken,) if rates.errors else (), tuple(describe_warnings(rates)))
    facts = (
        format_count(len(document.scenes), "scene"),
        format_count(sum(rates.rollouts), "rollout"),
        f"seed {document.seed}",
        f"{format_percent(document.confidence)} intervals",
        *describe_grid(rates),
    )
    return RatesModel(
        document.name,
        document.description or "",
        facts,
        tuple(f"{_typeset(balance.describe(rates.driver))}." for balance in rates.balances),
        tuple(filter(None, notices)),
        {unit: _make_axis(several) for unit, several in totals.items()},
        tuple(_build_rate(*row) for row in rows),
        (
            *_list_versions(rates),
            *(_list_scenes(rates, rate) for rate in rates.rates),
            *_list_own_estimates(rates),
            _list_exposures(rates),
        ),
    )


def _list_rates(rates: CatalogueRates) -> Iterator[tuple[str, str, RuleRate, str, Total]]:
    # rule and driver of each rate, that of the stack before that of another driver
    others = rates.reference.rates if rates.reference is not None else ()
    for rate, other in zip_longest(rates.rates, others):
        for unit, total in rate.totals.items():
            yield rate.rule, "", rate, unit, total
            if other is not None:
                yield rate.rule, rates.driver, other, unit, other.totals[unit]


def _list_versions(rates: CatalogueRates) -> list[Table]:
    rows = [tuple(map(_typeset, row[:-1])) for row in list_scenes(rates, typeset=True)]
    if not rows:
        return []
    text = f"Probabilities of the stack and of {rates.driver}."
    heads = ("Rule", "Scene", "Stack", "Interval", "Driver", "Interval", "Stack / driver")
    return [Table("Stack and driver", text, heads, tuple(rows), (1,))]


def _typeset(text: str) -> str:
    return text.replace(" .. ", " – ")


def _make_axis(totals: Sequence[Total]) -> Scale:
    ends = [end for total in totals for end in (*total.interval, total.value)]
    return make_log_scale([*ends, *(total.interval[1] / 10.0 for total in totals)])


def _build_rate(rule: str, driver: str, rate: RuleRate, unit: str, total: Total) -> Rate:
    verdicts = [
        (decision.verdict, f"{decision.threshold.text}{decision.explanation}")
        for decision in rate.decisions
        if decision.threshold.unit == unit
    ]
    intervals = total.interval, total.sampling, total.exposure
    return Rate(rule, driver, unit, total.value, *intervals, tuple(verdicts))


def _list_scenes(rates: CatalogueRates, rate: RuleRate) -> Table:
    # those that contribute most first
    total, sentence = next(iter(rate.totals.values())), describe_scenes(rates, rate)
    scenes = zip(rates.catalogue.document.scenes, rates.estimates, total.shares, total.doubts, strict=True)
    rows = [
        (
            entry.name,
            _describe(estimates[rate.rule]),
            format_percent(round(share, 3)) if total.value else "–",
            format_percent(round(doubt, 3)),
        )
        for entry, estimates, share, doubt in sorted(scenes, key=lambda scene: -scene[2])
    ]
    heads = ("Scene", "Failures", "Share of the rate", "Share of the interval's squared width")
    return Table(rate.rule, f"{sentence[:1].upper()}{sentence[1:]}.", heads, tuple(rows))


def _describe(estimate: SceneEstimate) -> str:
    result = estimate.result
    if estimate.follows_counts:
        return f"{result.failures.count:,} of {result.rollouts:,}"
    return f"{format_typeset(result.probability)} by {result.estimator}"


def _list_own_estimates(rates: CatalogueRates) -> list[Table]:
    rows = [
        (
            scene,
            rule,
            estimate.result.estimator,
            format_typeset(estimate.result.probability),
            format_typeset_interval(estimate.result.interval),
            f"{estimate.result.rollouts:,}",
            f"{estimate.result.simulated_steps:,}",
            ", ".join(estimate.warnings) or "–",
        )
        for scene, rule, estimate in rates.own
    ]
    if not rows:
        return []
    text = "Estimates with intervals of their own. The pilot does not share their cost."
    heads = ("Scene", "Rule", "Estimator", "Probability", "Interval", "Rollouts", "Steps", "Warnings")
    lines = tuple(f"{line}." for line in describe_blind(rates))
    return [Table("Estimators of the scenes’ own", text, heads, tuple(rows), (1, 2, 7), lines)]


def _list_exposures(rates: CatalogueRates) -> Table:
    document = rates.catalogue.document
    rows = [
        (
            entry.name,
            entry.scenario,
            f"{format_typeset(exposure.value)} per {entry.unit}"
            if entry.exposure
            else f"{entry.cells:,} cells",
            format_typeset_interval((exposure.low, exposure.high)),
            f"{rollouts:,}",
        )
        for entry, exposure, rollouts in zip(document.scenes, rates.exposures, rates.rollouts, strict=True)
    ]
    exception = " or its own estimator took" if any(rates.own) else ""
    text = f"How often each scene is met, and the rollouts that the pilot gave it{exception}."
    if document.speed:
        text += f" Hours and km are converted at {document.speed:g} km/h."
    return Table("Scenes", text, ("Scene", "Scenario", "Exposure", "Interval", "Rollouts"), tuple(rows), (1,))
