"""Charts of level and surviving share."""

from dataclasses import replace

import numpy as np
import pytest

from avrare_estimators.common.level_charts import draw_charts
from plain_results import plain_result


def drawn(**diagnostics):
    result = plain_result(estimator="ess", diagnostics=diagnostics)
    return draw_charts(replace(result, robustness=np.array([-1.0, 1.0, 2.0, 3.0])))


def test_the_surviving_share_is_that_of_the_particles():
    killed = drawn(levels=[[1.0, 2.0], [3.0]], full_rollouts=100, roots=[3, 4], discarded=[[5, 10], [25]])
    shares = drawn(levels=[[1.0, 2.0], [3.0]], shares=[[0.9, 0.8], [0.5]])
    assert killed == shares
    lines = [layer.pieces[0] for layer in shares[-1].layers]
    assert lines == [((0.0, 1.0), (1.0, 0.9), (2.0, pytest.approx(0.72))), ((0.0, 1.0), (1.0, 0.5))]


def test_without_levels_the_histogram_is_of_all_rollouts():
    assert [chart.caption for chart in drawn()] == ["Robustness of the rollouts"]
    first, *others = drawn(levels=[[1.0]], shares=[[0.5]])
    assert first.caption == "Robustness of the rollouts of the first stage"
    assert [chart.caption for chart in others] == ["Levels", "Survivors"]


@pytest.mark.parametrize("value", ["low", 3.0, [1.0, 2.0], {"a": 1}, [["x"]], [[[1.0]]], [[]]])
def test_levels_of_another_kind_are_not_drawn(value):
    assert len(drawn(levels=value, shares=[[0.5]])) == 1
    assert len(drawn(levels=[[1.0]], shares=value)) == 1 or value == [[]]
    assert len(drawn(levels=[[1.0, None]], shares=[[0.5, None]])) == 3
