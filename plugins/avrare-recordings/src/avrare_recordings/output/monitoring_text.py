"""Text about a monitored recording: summary, chart for the terminal, JSON and CSV."""

from __future__ import annotations

import itertools
import math
import re
import textwrap

import numpy as np
from rich.text import Text

from avrare.analysis.monitor.monitoring import (
    MonitoringResult,
    format_sample_time,
    list_exclusions,
    summarise,
)
from avrare.base.number_format import format_robustness
from avrare.protocols import Floats

_UP_BLOCKS, _DOWN_BLOCKS = " ▁▂▃▄▅▆▇█", " ▔▀█"
_UP_ROWS, _DOWN_ROWS = 4, 3


def headline(result: MonitoringResult) -> list[Text]:
    """Return source, formula and summary of a monitored recording."""
    recording = result.recording
    last = recording.samples - 1
    span = "0 s"
    if recording.time(last):
        span = f"{format_sample_time(recording, 0)} to {format_sample_time(recording, last)} s"
    lines = [
        Text.assemble((result.name, "bold"), f"  {recording.source}"),
        Text(f"{recording.samples} samples, {recording.dt:g} s apart, {span}{_list_vehicles(result)}"),
    ]
    lines += [Text(line, style="cyan") for line in _wrap_formula_lines(result.formula)]
    colour = "bold red" if result.violated else "bold green"
    return [*lines, Text(), Text(_wrap(summarise(result), ""), style=colour)]


def _wrap_formula_lines(formula: str) -> list[str]:
    statements = formula.strip().splitlines()
    lines = [line for statement in statements for line in _wrap(statement, "  ").splitlines()]
    rest = list(itertools.dropwhile(lambda statement: re.match(r"\w+\([\w, ]*\) = ", statement), statements))
    # a longer formula is shown without its definitions
    if len(lines) <= 6 or not rest or len(rest) == len(statements):
        return lines
    return ["  (--json prints its definitions)", *(_wrap(statement, "  ") for statement in rest)]


def _wrap(line: str, indent: str) -> str:
    return textwrap.fill(
        line, 80, initial_indent=indent, subsequent_indent=indent + "    ", break_on_hyphens=False
    )


def _list_vehicles(result: MonitoringResult) -> str:
    recording = result.recording
    if "ego_x" not in recording.signals:
        return ""
    return f"; the ego and {', '.join(recording.names) or 'no other vehicle'}{list_exclusions(result)}"


def draw_chart(result: MonitoringResult) -> list[Text]:
    """Return robustness over time as bars, at most 80 columns wide; a bar shows its least value."""
    values = result.prefix if result.body is None else result.body
    scope = "of the samples so far" if result.body is None else "at each sample"
    bars = _bin(values)
    high, low = _find_largest(bars), _find_largest(-bars)
    labels = [_format_axis_label(values, high), "0", _format_axis_label(values, -low)]
    pad = max(map(len, labels))
    rows = [Text(f"robustness {scope}")]
    for row in reversed(range(_UP_ROWS if high else 0)):
        label = labels[0] if row == _UP_ROWS - 1 else ""
        rows.append(_draw_bar_row(f"{label:>{pad}} ", bars / high, row, _UP_ROWS, _UP_BLOCKS, "green"))
    for row in range(_DOWN_ROWS if low else 0):
        label = "0" if row == 0 else labels[2] if row == _DOWN_ROWS - 1 else ""
        rows.append(_draw_bar_row(f"{label:>{pad}} ", -bars / low, row, _DOWN_ROWS, _DOWN_BLOCKS, "red"))
    begin, end = (f"{format_sample_time(result.recording, t)} s" for t in (0, len(values) - 1))
    gap = " " * max(len(bars) - len(begin) - len(end), 1)
    return [*rows, Text(f"{'' if low else '0':>{pad}}  {begin}{gap}{end}")]


def _bin(values: Floats) -> Floats:
    # the least of the samples of each column, so that no violation is hidden
    width = 64
    if len(values) >= width:
        edges = np.arange(width) * len(values) // width
        return np.asarray(np.minimum.reduceat(values, edges))
    return np.repeat(values, width // len(values))


def _find_largest(values: Floats) -> float:
    # of the finite values above zero; 1 if all above zero are infinite, 0 if there are none
    above = values[values > 0.0]
    finite = above[np.isfinite(above)]
    return float(finite.max()) if len(finite) else float(len(above) > 0)


def _format_axis_label(values: Floats, edge: float) -> str:
    if edge == 0.0:
        return ""
    finite = np.isfinite(values[values * np.sign(edge) > 0.0]).any()
    return format_robustness(edge if finite else math.copysign(math.inf, edge))


def _draw_bar_row(label: str, shares: Floats, row: int, rows: int, blocks: str, colour: str) -> Text:
    # bars of ``shares`` of the height of the chart; any above 0 is visible
    full = len(blocks) - 1
    heights = np.ceil(np.clip(shares, 0.0, 1.0) * rows * full).astype(int)
    cells = "".join(blocks[min(max(height - row * full, 0), full)] for height in heights)
    return Text.assemble(label, ("▏", "dim"), (cells.rstrip(), colour))
