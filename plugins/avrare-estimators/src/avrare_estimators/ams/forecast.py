"""Forecast of the cost of splitting: for two likely probabilities, then by the cost of the pilot."""

from __future__ import annotations

import math

from avrare.estimation.plan.plan import CostForecast
from avrare_estimators.ams.state import AmsState
from avrare_estimators.common.looks import LIKELY, RARE, Looks


def forecast_cost(state: AmsState, looks: Looks, growth: int, slope: float) -> CostForecast | None:
    """Return the simulated steps of the whole estimate; None between two batches of runs.

    A first stage of f steps and levels down to p cost f (1 + slope log p), with a slope that is measured as
    soon as the levels have come some way. The probability is not known before the pilot has ended: until
    then the forecast is for two of them.

    Args:
        state: State after a stage.
        looks: Numbers of runs that count, where the pilot has not ended.
        growth: Largest factor by which the pilot may let runs grow.
        slope: Cost of levels before any is measured, negative.
    """
    if state.looks is not None and state.pilot is not None:
        return state.pilot.forecast("steps", state.looks, state.done, spent=state.pilot.cost)
    weights = state.weight[state.active]
    if not len(weights) or not weights.any():
        return None
    first, fallen = state.particles * max(state.plan.steps, 1), math.log(weights.mean())
    # half of the particles are left: the levels show the cost of further ones
    if fallen < math.log(0.5) and state.ended is None:
        slope = (state.tally.steps / (state.runs * first) - 1.0) / fallen
    ends = min(math.log(LIKELY), fallen), min(math.log(RARE), fallen + math.log(LIKELY))
    likely, rare = (first * (1.0 + slope * end) for end in ends)
    if state.looks is None:  # the pilot is one run more
        likely, rare = likely * (1 + looks.runs[0]), rare * (1 + growth * looks.runs[-1])
    else:
        likely, rare = likely * max(state.done, state.looks.runs[0]), rare * state.looks.runs[-1]
    basis = f"p {math.exp(ends[0]):.1g} .. {math.exp(ends[1]):.1g}"
    return CostForecast("steps", likely, rare, basis)
