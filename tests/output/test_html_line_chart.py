"""Axes and lines of charts."""

import math

import numpy as np
import pytest

from avrare.base.chart import Chart, Scale, make_linear_scale, make_log_scale
from avrare.output.html.pictures import draw_path, place_bars


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
    chart = Chart(Scale(0.0, 3.0), Scale(0.0, 1.0), "t")
    chart = chart.line(np.arange(4), np.array([0.0, 1.0, np.nan, 0.5]))
    assert draw_path(chart, chart.layers[0]) == "M0 100L33.33 0M100 50"


def test_each_kind_of_layer_has_its_path():
    chart = Chart(Scale(-1.0, 1.0), Scale(-1.0, 3.0), "t")
    x, y = np.array([-1.0, 0.0, 1.0]), np.array([-1.0, np.inf, 1.0])
    drawn = chart.dots(x, y).band(x[:2], y[:1].repeat(2), np.zeros(2)).zero().zero(vertical=True).moment(1.0)
    paths = [draw_path(drawn, layer) for layer in drawn.layers]
    assert paths == ["M0 100h0M100 50h0", "M0 75L50 75L50 100L0 100Z", "M0 75H100", "M50 0V100", "M100 0V100"]
    assert not Chart(Scale(1.0, 2.0), Scale(1.0, 2.0), "t").zero().layers


def test_the_least_bar_is_visible():
    chart = Chart(Scale(0.0, 2.0), Scale(0.0, 1.0), "t")
    chart = chart.bars(np.array([0.0, 1.0, 2.0]), np.array([0.0, 1e-6]), "bar")
    assert place_bars(chart, chart.layers[0]) == [("50", "49.75", "99.2", "0.8")]
