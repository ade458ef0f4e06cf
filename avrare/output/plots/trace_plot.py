"""Plot of a trace: signals over time."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from avrare.base.errors import UsageError, did_you_mean
from avrare.base.plot import Plot
from avrare.output.plots import hide_spines, make_figure
from avrare.rollout.trace import Trace

_MAX_PANELS = 8
_SAFE, _VIOLATED = "#1b6ca8", "#b0443c"


def plot_trace(trace: Trace, signals: Sequence[str]) -> Plot:
    """Draw signals of a trace; see ``Trace.plot``."""
    names = _choose_signals(trace, signals)
    figure = make_figure(8.0, 0.7 + 1.3 * len(names))
    axes = np.atleast_1d(figure.subplots(len(names), 1, sharex=True))
    colour = _VIOLATED if trace.violated else _SAFE
    for ax, name in zip(axes, names, strict=True):
        values = np.asarray(trace[name], dtype=np.float64).reshape(len(trace.times), -1)
        labels = _label_columns(trace, name, values.shape[1])
        for column, label in zip(values.T, labels, strict=True):
            ax.plot(trace.times, column, lw=1.4, color=colour if len(labels) == 1 else None, label=label)
        if 1 < len(labels) <= _MAX_PANELS:
            ax.legend(fontsize=7, frameon=False, ncols=2)
        ax.set_ylabel(name, fontsize=8)
        ax.tick_params(labelsize=8)
        ax.margins(x=0.0)
        hide_spines(ax, "top", "right")
    axes[-1].set_xlabel("time [s]" if trace.unit == "s" else "step", fontsize=9)
    figure.suptitle(trace.describe(), fontsize=10)
    return Plot(figure)


def _choose_signals(trace: Trace, signals: Sequence[str]) -> list[str]:
    for name in signals:
        if name not in trace:
            raise UsageError(f"the trace has no signal {name!r}", did_you_mean(name, trace))
    if signals:
        return list(signals)
    numbers = [name for name, values in trace.items() if np.asarray(values).dtype.kind in "fiub"]
    return ([name for name in numbers if name in trace.formula] or numbers)[:_MAX_PANELS]


def _label_columns(trace: Trace, name: str, count: int) -> list[str]:
    if trace.scene is not None and count == len(trace.scene.names):
        return list(trace.scene.names)
    return [name] if count == 1 else [f"{name}[{k}]" for k in range(count)]
