"""Plots of a drive show every vehicle near the ego."""

import numpy as np
import pytest
from matplotlib import figure as figures

from avrare.analysis.page.player import _encode_prediction
from avrare.driving import Prediction, Road, Scene, Vehicles, World
from avrare.output.plots.rollout_plot import plot_drive
from avrare.rollout.replay import Frame


def vehicles(x, y):
    x, y = np.array([x], dtype=float), np.array([y], dtype=float)
    return Vehicles(x, y, *np.zeros((3, *x.shape)))


@pytest.fixture
def axes(tmp_path, monkeypatch):
    """Return axes of a plot with an ego at x and one vehicle 30 m ahead of it, for each x."""

    def draw(places, y, end):
        road = Road(lane_centres=(0.0, 4.0), lane_width=4.0, end=end)
        scene = Scene(0.1, road, 4.0, 2.0, ("other",), *np.array([[4.0], [2.0]]), np.array([True]))
        frames = []
        for t, x in enumerate(places):
            world = World(np.array([t]), vehicles(x, 0.0), vehicles([x + 30.0], [y]), np.zeros(1))
            frames.append(Frame(t, world, *[None] * 3))
        drawn = []
        monkeypatch.setattr(figures.Figure, "savefig", lambda self, *_, **__: drawn.append(self))
        plot_drive(frames, scene, "title").save(tmp_path / "drive.png")
        return drawn[0].axes

    return draw


@pytest.mark.parametrize("y", [0.0, 4.0, -9.0, 12.0])
def test_a_long_road_is_followed(axes, y):
    for ax, x in zip(axes([100.0, 900.0], y, end=1000.0), (100.0, 900.0), strict=True):
        left, right = ax.get_xlim()
        low, high = ax.get_ylim()
        assert left < x < x + 30.0 < right < left + 300.0
        assert low < y - 1.0 < y + 3.0 < high


def test_a_short_road_is_drawn_completely(axes):
    for ax in axes([20.0, 120.0], 0.0, end=200.0):
        assert ax.get_xlim() == (0.0, 200.0)


def test_a_vehicle_without_a_track_has_no_prediction():
    x = np.array([[[1.0, 2.0], [np.inf, np.inf]]])
    frame = Frame(0, None, None, Prediction(x, x + 0.5))
    assert _encode_prediction(frame) == [[[1.0, 1.5], [2.0, 2.5]]]
