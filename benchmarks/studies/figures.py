"""Figures without a display, as the programs in benchmarks/ draw them."""

from __future__ import annotations

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

BLUE, ORANGE, GREY, RED, GREEN = "#1b6ca8", "#d9701a", "#8a949c", "#b0443c", "#2e8b57"


def make_axes(
    width: float, height: float, columns: int = 1, widths: tuple[float, ...] | None = None
) -> tuple[Figure, list[Axes]]:
    """Return a figure of this size [inches], and its axes from left to right."""
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    axes = list(figure.subplots(1, columns, squeeze=False, width_ratios=widths)[0])
    for ax in axes:
        ax.spines[["top", "right"]].set_visible(False)
    return figure, axes
