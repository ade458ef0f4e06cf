"""Sentences about a catalogue's rates."""

from __future__ import annotations

from avrare.analysis.rates.rates import CatalogueRates, RuleRate
from avrare.base.number_format import (
    format_interval,
    format_percent,
    format_probability,
    format_ratio,
    format_typeset,
    format_typeset_interval,
)


def describe_warnings(rates: CatalogueRates) -> list[str]:
    """Return the health warnings of all scenes; each line once, after its scenes and rules."""
    lines: dict[str, list[str]] = {}
    for entry, estimates in zip(rates.catalogue.document.scenes, rates.estimates, strict=True):
        for rule, estimate in estimates.items():
            for name, text in estimate.warnings.items():
                lines.setdefault(f"warning {name}: {text}", []).append(f"{entry.name} {rule}")
    return [f"{', '.join(places)}: {text}" for text, places in lines.items()]


def describe_blind(rates: CatalogueRates) -> list[str]:
    """List upper bounds on failures that the estimators' scores do not lead to."""
    sentences = []
    for rate in rates.rates:
        for unit, bound in list(rate.blind.items())[:1]:
            text = "failures that the score or proposal of a scene's estimator does not lead to"
            sentences.append(f"{rate.rule}: {text} could add {format_probability(bound, 2)} per {unit}")
    return sentences


def describe_grid(rates: CatalogueRates) -> list[str]:
    """Return that the rates are shares of cells; nothing where the scenes have exposures."""
    cells = sum(entry.cells or 0 for entry in rates.catalogue.document.scenes)
    return [f"share of {cells:,} cells, no exposure"] if cells else []


def describe_scenes(rates: CatalogueRates, rate: RuleRate) -> str:
    """Name the scenes that contribute most to a rate, and the scene that widens its interval most."""
    total = next(iter(rate.totals.values()))
    names = [entry.name for entry in rates.catalogue.document.scenes]
    doubtful = max(zip(total.doubts, names, strict=True))
    doubt = f"{format_percent(round(doubtful[0], 2))} of the interval's squared width is from {doubtful[1]}"
    if len(names) == 1:
        return f"all from {names[0]}" if total.value else "no failure was seen"
    if not total.value:
        return f"no failure was seen; {doubt}"
    largest = sorted(zip(total.shares, names, strict=True), reverse=True)[:3]
    parts = [f"{name} {format_percent(round(share, 2))}" for share, name in largest if share]
    return f"mostly {', '.join(parts)}; {doubt}"


def list_scenes(rates: CatalogueRates, typeset: bool = False) -> list[tuple[str, ...]]:
    """Return rule, scene, both probabilities with intervals, their ratio and the share of the rate."""
    number = format_typeset if typeset else format_probability
    span = format_typeset_interval if typeset else format_interval
    if rates.reference is None:
        return []
    rows = []
    scenes = list(
        zip(rates.catalogue.document.scenes, rates.estimates, rates.reference.estimates, strict=True)
    )
    for balance, rate in zip(rates.balances, rates.rates, strict=True):
        total = next(iter(rate.totals.values()))
        rows_of_rule = zip(scenes, balance.scenes, total.shares, strict=True)
        for (entry, *versions), (ratio, interval), share in rows_of_rule:
            results = [version[balance.rule].result for version in versions]
            cells = [
                text for result in results for text in (number(result.probability), span(result.interval))
            ]
            has_failed = any(result.probability for result in results)
            quotient = format_ratio(ratio, interval) if has_failed else "not known"
            percent = format_percent(round(share, 3)) if total.value else "–" if typeset else "-"
            rows.append((balance.rule, entry.name, *cells, quotient, percent))
    return rows
