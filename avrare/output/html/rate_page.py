"""HTML report of a catalogue's rates: one self-contained file without a script."""

from __future__ import annotations

from collections.abc import Sequence

from avrare.analysis.rates.combination import Total
from avrare.analysis.rates.rates import CatalogueRates, RuleRate
from avrare.analysis.rates.scene_estimates import SceneEstimate
from avrare.analysis.rates.sentences import describe_blind, describe_scenes, describe_warnings
from avrare.base.chart import Scale, make_log_scale
from avrare.output.html.environment import load_templates, read_asset


def render_rates(rates: CatalogueRates) -> str:
    """Return the report of a catalogue as HTML."""
    page = (
        load_templates()
        .get_template("rates.html")
        .render(
            rates=rates,
            axes=_make_axes(rates),
            scenes=[(rate, describe_scenes(rates, rate), _list_scenes(rates, rate)) for rate in rates.rates],
            own=list(rates.own),
            warnings=describe_warnings(rates),
            blind=describe_blind(rates),
            style=read_asset("style.css"),
        )
    )
    return page + "\n"


def _make_axes(rates: CatalogueRates) -> dict[str, Scale]:
    totals: dict[str, list[Total]] = {}
    for rate in rates.rates:
        for unit, total in rate.totals.items():
            totals.setdefault(unit, []).append(total)
    return {unit: _make_axis(several) for unit, several in totals.items()}


def _make_axis(totals: Sequence[Total]) -> Scale:
    ends = [end for total in totals for end in (*total.interval, total.value)]
    return make_log_scale([*ends, *(total.interval[1] / 10.0 for total in totals)])


def _list_scenes(rates: CatalogueRates, rate: RuleRate) -> list[tuple[str, SceneEstimate, float, float]]:
    # those that contribute most first
    total = next(iter(rate.totals.values()))
    rows = [
        (entry.name, estimates[rate.rule], share, doubt)
        for entry, estimates, share, doubt in zip(
            rates.catalogue.document.scenes, rates.estimates, total.shares, total.doubts, strict=True
        )
    ]
    return sorted(rows, key=lambda row: -row[2])
