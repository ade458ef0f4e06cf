"""Model of the page of a catalogue's rates."""

from __future__ import annotations

from collections.abc import Sequence

from avrare.analysis.page.rates_model import (
    OwnEstimate,
    Rate,
    RatesModel,
    RuleScenes,
    SceneExposure,
    SceneShare,
)
from avrare.analysis.rates.combination import Total
from avrare.analysis.rates.rates import CatalogueRates, RuleRate
from avrare.analysis.rates.scene_estimates import SceneEstimate
from avrare.analysis.rates.sentences import describe_blind, describe_scenes, describe_warnings
from avrare.base.chart import Scale, make_log_scale


def build_rates(rates: CatalogueRates) -> RatesModel:
    """Return everything that the page of a catalogue shows."""
    document = rates.catalogue.document
    totals: dict[str, list[Total]] = {}
    for rate in rates.rates:
        for unit, total in rate.totals.items():
            totals.setdefault(unit, []).append(total)
    rows = zip(document.scenes, rates.exposures, rates.rollouts, strict=True)
    return RatesModel(
        document.name,
        document.description or "",
        sum(rates.rollouts),
        document.seed,
        document.confidence,
        document.speed,
        rates.errors,
        tuple(describe_warnings(rates)),
        {unit: _make_axis(several) for unit, several in totals.items()},
        tuple(_build_rate(rate, unit, total) for rate in rates.rates for unit, total in rate.totals.items()),
        tuple(_build_rule(rates, rate) for rate in rates.rates),
        tuple(
            OwnEstimate(
                scene,
                rule,
                own.estimator,
                own.probability,
                own.interval,
                estimate.rollouts,
                own.simulated_steps,
                tuple(estimate.warnings),
            )
            for scene, rule, estimate, own in rates.own
        ),
        tuple(describe_blind(rates)),
        tuple(
            SceneExposure(
                entry.name,
                entry.scenario,
                exposure.value,
                (exposure.low, exposure.high),
                entry.exposure.unit,
                rollouts,
            )
            for entry, exposure, rollouts in rows
        ),
    )


def _make_axis(totals: Sequence[Total]) -> Scale:
    ends = [end for total in totals for end in (*total.interval, total.value)]
    return make_log_scale([*ends, *(total.interval[1] / 10.0 for total in totals)])


def _build_rate(rate: RuleRate, unit: str, total: Total) -> Rate:
    decisions = [decision for decision in rate.decisions if decision.threshold.unit == unit]
    verdicts = [
        (decision.verdict, f"{decision.threshold.text}{decision.explanation}") for decision in decisions
    ]
    return Rate(rate.rule, unit, total.value, total.interval, total.sampling, total.exposure, tuple(verdicts))


def _build_rule(rates: CatalogueRates, rate: RuleRate) -> RuleScenes:
    total, sentence = next(iter(rate.totals.values())), describe_scenes(rates, rate)
    scenes = [
        _build_share(entry.name, estimates[rate.rule], share, doubt)
        for entry, estimates, share, doubt in zip(
            rates.catalogue.document.scenes, rates.estimates, total.shares, total.doubts, strict=True
        )
    ]
    ordered = sorted(scenes, key=lambda scene: -scene.share)
    return RuleScenes(rate.rule, f"{sentence[:1].upper()}{sentence[1:]}.", tuple(ordered))


def _build_share(scene: str, estimate: SceneEstimate, share: float, doubt: float) -> SceneShare:
    probability, estimator = (
        (0.0, "") if estimate.own is None else (estimate.own.probability, estimate.own.estimator)
    )
    return SceneShare(scene, estimate.failures, estimate.rollouts, probability, estimator, share, doubt)
