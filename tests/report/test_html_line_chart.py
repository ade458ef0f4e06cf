"""Axes and lines of charts."""

import math

import numpy as np
import pytest

from avrare.report.html.line_chart import LineChart, Scale, make_linear_scale, make_log_scale


@pytest.mark.parametrize(
    ("values", "ticks"),
    [
        ([0.0, 1.0], ["0", "0.2", "0.4", "0.6", "0.8", "1"]),
        ([-0.3, 0.1], ["−0.3", "−0.2", "−0.1", "0", "0.1"]),
    ],
)
def test_linear_ticks_are_round(values, ticks):
    assert [word for _, word in make_linear_scale(values, margin=0.0).ticks()] == ticks


@pytest.mark.parametrize("values", [[], [math.nan], [2.0, 2.0], [1e300, 1e300], [0.0], [math.inf, 1.0]])
def test_any_values_have_an_axis(values):
    scale = make_linear_scale(values)
    assert scale.low < scale.high
    assert scale.ticks()
    assert 0.0 <= scale.at(scale.low) < scale.at(scale.high) <= 100.0


def test_a_logarithmic_axis_spans_the_values_up_to_its_limit():
    scale = make_log_scale([3e-5, 0.2], 1.0)
    assert (scale.low, scale.high) == pytest.approx((1e-5, 1.0))
    assert [word for _, word in scale.ticks()] == ["10⁻⁵", "10⁻⁴", "10⁻³", "10⁻²", "0.1", "1"]
    assert scale.at(1e-5) == 0.0
    assert scale.at(0.0) == 0.0
    assert make_log_scale([], 1.0).low < make_log_scale([], 1.0).high


def test_lines_have_gaps_at_missing_values():
    plot = LineChart(Scale(0.0, 3.0), Scale(0.0, 1.0), "t")
    plot.draw_line(np.arange(4), np.array([0.0, 1.0, np.nan, 0.5]))
    html = plot.render()
    assert 'd="M0 100L33.33 0M100 50"' in html
