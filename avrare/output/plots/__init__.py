"""Matplotlib figures that are written without a display."""

from __future__ import annotations

import importlib.util
from typing import TYPE_CHECKING

from avrare.base.visible_text import spell_controls

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def has_matplotlib() -> bool:
    """Return whether matplotlib is installed."""
    return importlib.util.find_spec("matplotlib") is not None


def make_figure(width: float, height: float) -> Figure:
    """Return a figure of a size [inches] that is drawn without a display."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def plain(text: str) -> str:
    """Return text in which matplotlib finds no formula."""
    return spell_controls(text).replace("$", r"\$")


def hide_spines(ax: Axes, *sides: str) -> None:
    """Hide the frame of the axes on some sides."""
    for side in sides:
        ax.spines[side].set_visible(False)
