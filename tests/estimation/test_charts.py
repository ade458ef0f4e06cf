"""Charts of an estimate: of any estimator, and of Monte Carlo."""

from dataclasses import replace

import numpy as np

from avrare.estimation.monte_carlo.charts import draw_charts
from avrare.estimation.result import charts
from plain_results import plain_result


def drawn(draw=draw_charts, robustness=(-1.0, 1.0, 1.0, 1.0), **fields):
    return draw(replace(plain_result(**fields), robustness=np.array(robustness)))


def test_zero_is_an_edge_of_the_histogram():
    edges = charts._choose_bin_edges(np.array([-0.3, 1.1, 2.0]))
    assert 0.0 in edges
    assert edges[0] <= -0.3
    assert edges[-1] >= 2.0
    assert drawn(charts.draw_histogram, (np.nan, np.inf)) == ()


def test_convergence_is_left_out_where_failures_are_unknown():
    for law in ({}, {"diagnostics": {"used_rollouts": 4}}, {"trials": 4}):
        assert len(drawn(failures=5, rollouts=9, **law)) == 1
    histogram, convergence = drawn(failures=1)
    assert histogram.caption == "Robustness of the rollouts"
    assert "ending at 0.25" in convergence.title
    assert len(drawn(failures=5, trials=9)) == 2  # only the first rollouts are kept


def test_convergence_over_an_ensemble_is_that_of_the_scenarios_own_model():
    assert drawn(failures=1)[1].caption == "Convergence"
    convergence = drawn(failures=1, members=2)[1]
    assert convergence.caption == "Convergence under the scenario's own model"
    assert convergence.legend[1][1].endswith("interval of that many, of sampling alone")
    runs = {"run_probabilities": np.array([0.1, 0.2]), "interval": (0.05, 0.3)}
    assert len(drawn(charts.draw_charts, **runs)) == 2
    assert len(drawn(charts.draw_charts, **runs, members=2)) == 1  # these are no runs
