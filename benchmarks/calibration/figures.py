"""Figures of the benchmark: coverage, cost against p, and the matrix of confident wrong shares."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.colors import LinearSegmentedColormap

from avrare.estimation.result.intervals import clopper_pearson
from benchmarks.calibration.problems import problems
from benchmarks.calibration.summary import Row, trusted

mpl.use("Agg")
from matplotlib import pyplot as plt

_MARKERS = "os^vD<>Pp*XHd+x"
_RED, _OTHER = "#c0392b", "#8a949c"
_COLOURS = {
    "avrare": "#1b6ca8", "openturns": "#d9701a", "uqpy": "#3a8f4d", "pytams": "#8e44ad",
    "textbook": "#444444", "sentil": "#b8860b", "verifai": "#c2185b",
}  # fmt: skip
"""Colour of a family of tools; its methods differ by their marks."""
_NOMINAL = 0.95


def draw(rows: Sequence[Row], folder: Path) -> None:
    """Draw all figures of the rows of one setting and budget."""
    folder.mkdir(parents=True, exist_ok=True)
    plt.rcParams.update({"font.size": 9, "axes.spines.top": False, "axes.spines.right": False})
    tools = list(dict.fromkeys(row.tool for row in rows))
    for name, figure in (
        ("coverage", _coverage(rows, tools)),
        ("cost", _cost(rows, tools)),
        ("wrong", _wrong(rows, tools)),
    ):
        figure.savefig(folder / f"{name}.png", dpi=110, bbox_inches="tight")
        plt.close(figure)


def _coverage(rows: Sequence[Row], tools: Sequence[str]) -> Any:
    """Draw, for each tool, the coverage of each problem as a dot and of all intervals as a bar."""
    figure, axes = plt.subplots(figsize=(8, 0.34 * len(tools) + 1.2))
    generator = np.random.default_rng(0)
    for place, tool in enumerate(tools):
        own = [row for row in rows if row.tool == tool and row.stated]
        if not own:
            continue
        shares = np.array([row.covers for row in own])
        total = sum(len(row.stated) for row in own)
        mean = float(sum(row.covers * len(row.stated) for row in own) / total)
        axes.scatter(
            shares, place + generator.uniform(-0.22, 0.22, len(own)), s=[5 * len(row.stated) for row in own],
            color="#7a9cc6", alpha=0.6, lw=0,
        )  # fmt: skip
        ends = clopper_pearson(round(mean * total), total, _NOMINAL)
        axes.plot(ends, [place, place], color=_RED, lw=1.2)
        axes.plot([mean, mean], [place - 0.38, place + 0.38], color=_RED, lw=2.5)
        axes.text(1.03, place, f"{mean:.2f}  ({len(own)})", va="center", fontsize=8)
    axes.axvline(_NOMINAL, color="#444444", lw=1, ls=":")
    axes.set(yticks=range(len(tools)), yticklabels=tools, xlim=(-0.03, 1.02))
    axes.set_xlabel(
        "share of 95 % intervals that hold the truth (dots: problems, larger with more answers; red: all)"
    )
    axes.invert_yaxis()
    return figure


def _cost(rows: Sequence[Row], tools: Sequence[str]) -> Any:
    """Draw relative mean squared error times evaluations against p, of answers that may be trusted."""
    figure, axes = plt.subplots(figsize=(8, 5))
    seen: dict[str, int] = {}
    for tool in tools:
        family = tool.split(" ", 1)[0]
        marker = _MARKERS[seen.setdefault(family, 0)]
        seen[family] += 1
        own = [row for row in rows if row.tool == tool and trusted(row) and row.cost > 0.0]
        if own:
            axes.scatter(
                [row.problem.probability for row in own], [row.cost for row in own], s=26, marker=marker,
                color=_COLOURS.get(family, _OTHER), label=tool, alpha=0.75, lw=0.8 if marker in "+x" else 0,
            )  # fmt: skip
    p = np.geomspace(1e-9, 2e-2, 50)
    axes.plot(p, (1 - p) / p, color="#444444", lw=1, ls=":", label="Monte Carlo, exact")
    axes.set(xscale="log", yscale="log", xlabel="p", ylabel="relative mean squared error x evaluations")
    axes.legend(fontsize=7, ncol=1, frameon=False, bbox_to_anchor=(1.0, 1.0), loc="upper left")
    return figure


def _wrong(rows: Sequence[Row], tools: Sequence[str]) -> Any:
    """Draw a matrix: problem by tool, red where answers are confidently wrong, grey where there is none."""
    names = [name for name in problems() if any(row.problem.name == name for row in rows)]
    shares = np.full((len(names), len(tools)), np.nan)
    found: dict[tuple[int, int], Row] = {}
    for row in rows:
        place = names.index(row.problem.name), tools.index(row.tool)
        found[place] = row
        if row.stated:
            shares[place] = row.wrong_share
    figure, axes = plt.subplots(figsize=(0.42 * len(tools) + 2.5, 0.19 * len(names) + 1.5))
    reds = LinearSegmentedColormap.from_list("wrong", ["#d5e8d4", "#f4c7a1", _RED])
    reds.set_bad("#ffffff")
    image = axes.imshow(shares, cmap=reds, vmin=0, vmax=1, aspect="auto")
    for (y, x), row in found.items():
        if math.isnan(shares[y, x]):
            axes.text(x, y, "–", ha="center", va="center", fontsize=7, color="#888888")
        elif row.wrong:
            axes.text(x, y, f"{row.wrong}/{len(row.cells)}", ha="center", va="center", fontsize=5.5)
    axes.set_xticks(np.arange(len(tools) + 1) - 0.5, minor=True)
    axes.set_yticks(np.arange(len(names) + 1) - 0.5, minor=True)
    axes.grid(which="minor", color="white", lw=0.8)
    axes.tick_params(which="minor", length=0)
    axes.set_xticks(range(len(tools)), tools, rotation=55, ha="right", fontsize=8)
    axes.set_yticks(range(len(names)), names, fontsize=7)
    axes.xaxis.set_ticks_position("bottom")
    bar = figure.colorbar(image, ax=axes, fraction=0.03, pad=0.02)
    bar.set_label("share of answers that are confidently wrong")
    return figure
