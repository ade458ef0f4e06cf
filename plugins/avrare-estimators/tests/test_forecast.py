"""Forecasts of cost: there from the first chunk on, kept by estimates, and told again after every stage."""

import avrare
from avrare.testing.faulty_systems import Walk


def followed(estimator, limit=7.0, **options):
    """Estimate on a walk of 6 steps; return the result and the state after every chunk."""
    problem = avrare.Problem(Walk(scale=1.0), avrare.stl(f"always (x < {limit})"), steps=6, chunk=50)
    seen = []
    result = avrare.estimate(problem, estimator, seed=1, progress=seen.append, **options)
    return result, seen


def test_splitting_forecasts_for_two_probabilities_and_then_by_its_pilot():
    result, seen = followed("ams", particles=50, discard=10, runs=11, grow=True)
    first = seen[0].forecast
    assert (first.kind, first.given) == ("steps", "p 0.01 .. 1e-06")
    assert first.least < seen[-1].steps < first.most
    (forecast,) = {info.forecast for info in seen if info.forecast and info.forecast.given == "by the pilot"}
    assert forecast.least == forecast.most
    assert 0.7 < seen[-1].steps / forecast.most < 1.4
    assert result.diagnostics["pilot_roots"] >= 0


def test_splitting_without_a_pilot_measures_what_levels_cost():
    _, seen = followed("ams", particles=50, discard=5, runs=4, grow=False)
    for info in (one for one in seen if one.forecast and 10 <= one.stage < 25):
        assert 0.7 * info.forecast.least < seen[-1].steps < info.forecast.most
    told = [info.forecast.least for info in seen if info.forecast]
    assert told[-1] > 0.8 * seen[-1].steps
    # a first stage, at the particles of all runs, is told to have a total
    assert (seen[0].stage_rows, seen[0].stage_done) == (200, 50)


def test_slice_sampling_forecasts_by_its_pilot():
    _, seen = followed("ess", chains=20, runs=5)
    assert seen[0].forecast.kind == "rollouts"
    forecast = next(info.forecast for info in seen if info.forecast.given == "by the pilot")
    assert 0.7 < seen[-1].rollouts / forecast.most < 1.4


def test_looks_leave_a_range():
    _, seen = followed("ams", limit=4.0, particles=50, discard=10, runs=10, grow=True, relative_error=0.2)
    forecast = next(info.forecast for info in seen if info.forecast and info.forecast.given == "by the pilot")
    assert forecast.least < forecast.most


def test_learned_proposals_have_firm_bounds_to_the_end():
    _, seen = followed("is", limit=3.5, rollouts=600, relative_error=0.3)
    for info in seen:
        assert info.forecast.least <= seen[-1].rollouts <= info.forecast.most


def test_monte_carlo_counts_the_failures_that_it_still_wants():
    _, seen = followed("mc", limit=3.0, relative_error=0.2)
    wanted = [info.forecast for info in seen if info.forecast.given]
    assert wanted[0].given.endswith(" of 27 failures")
    assert all(one.least < seen[-1].rollouts for one in wanted)
    _, seen = followed("mc", limit=3.0, threshold=0.01)
    assert (seen[0].forecast.least, seen[0].forecast.most) == (0.0, 1e6)
