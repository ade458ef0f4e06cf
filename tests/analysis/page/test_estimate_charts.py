"""Charts of an estimate."""

import numpy as np
import pytest

from avrare.analysis.page import estimate_charts as charts
from plain_results import plain_result


def test_the_surviving_share_is_that_of_the_particles():
    found = charts._list_surviving_shares(
        {"full_rollouts": 100, "roots": [3, 4], "discarded": [[5, 10], [25]]}
    )
    assert found == [[0.9, 0.8], [0.5]]
    assert charts._list_surviving_shares({"shares": [[0.1]], "levels": [[1.0]]}) == [[0.1]]
    assert charts.draw_levels({}, float, "") == ()


@pytest.mark.parametrize("found", ["low", 3.0, [1.0, 2.0], {"a": 1}, [["x"]], [[[1.0]]], [[]]])
def test_levels_of_another_kind_are_not_drawn(found):
    assert charts.draw_levels({"levels": found, "shares": [[0.5]]}, float, "") == ()
    assert charts.draw_levels({"levels": [[1.0]], "shares": found}, float, "") == () or found == [[]]
    assert charts.draw_levels({"levels": [[1.0, None]], "shares": [[0.5, None]]}, float, "")


def test_zero_is_an_edge_of_the_histogram():
    edges = charts._choose_bin_edges(np.array([-0.3, 1.1, 2.0]))
    assert 0.0 in edges
    assert edges[0] <= -0.3
    assert edges[-1] >= 2.0
    assert charts.draw_histogram(np.array([np.nan, np.inf]), False) is None


def test_convergence_is_left_out_where_failures_are_unknown():
    entry = plain_result(failures=5)
    assert charts.draw_convergence(entry, np.array([-1.0, 1.0, 1.0, 1.0])) is None
    for law in ({"diagnostics": {"used_rollouts": 4}}, {"trials": 4}):
        more = plain_result(failures=5, rollouts=9, **law)
        assert charts.draw_convergence(more, np.array([-1.0, 1.0, 1.0, 1.0])) is None
    found = charts.draw_convergence(plain_result(failures=1), np.array([-1.0, 1.0, 1.0, 1.0]))
    assert "ending at 0.25" in found.title


def test_convergence_over_an_ensemble_is_that_of_the_scenarios_own_model():
    several, found = {"members": 2}, np.array([-1.0, 1.0, 1.0, 1.0])
    entry = plain_result(failures=1)
    assert "own model" not in charts.draw_convergence(entry, found).caption
    drawn = charts.draw_convergence(plain_result(failures=1, **several), found)
    assert drawn.caption == "Convergence under the scenario's own model"
    assert drawn.legend[1][1].endswith("interval of that many, of sampling alone")
    runs = {"estimator": "ams", "run_probabilities": np.array([0.1, 0.2]), "interval": (0.05, 0.3)}
    assert charts.draw_convergence(plain_result(**runs), found) is not None
    assert charts.draw_convergence(plain_result(**runs, **several), found) is None  # these are no runs
