"""A scored recording as words, a chart for the terminal, and files."""

from __future__ import annotations

import csv
import io
import itertools
import math
import re
import textwrap
from pathlib import Path
from typing import Any

import numpy as np
from rich.text import Text

from avrare.estimation.result import finite
from avrare.protocols import Floats
from avrare.record.trace import Recording
from avrare.record.trace_causes import Moment
from avrare.record.trace_score import Score
from avrare.record.whole import write_text

_WIDTH = 80
_COLUMNS = 64
_UP, _DOWN = " ▁▂▃▄▅▆▇█", " ▔▀█"
_ROWS_UP, _ROWS_DOWN = 4, 3
_LONG = 6
"""A formula of more lines than this is shown without its definitions."""
_DEFINITION = r"\w+\([\w, ]*\) = "


def headline(score: Score) -> list[Text]:
    """What was scored, and the verdict in a sentence."""
    recording = score.recording
    end = recording.time(recording.samples - 1)
    span = f"{clock(recording, 0)} to {clock(recording, recording.samples - 1)} s" if end else "0 s"
    lines = [
        Text.assemble((score.name, "bold"), f"  {recording.source}"),
        Text(f"{recording.samples} samples, {recording.dt:g} s apart, {span}{_crowd(score)}"),
    ]
    lines += [Text(line, style="cyan") for line in _formula(score.formula)]
    colour = "bold red" if score.broken else "bold green"
    return [*lines, Text(), Text(_wrapped(sentence(score), ""), style=colour)]


def _formula(words: str) -> list[str]:
    """A formula in lines; of a long one what comes after its definitions."""
    statements = words.strip().splitlines()
    lines = [line for one in statements for line in _wrapped(one, "  ").splitlines()]
    rest = list(itertools.dropwhile(lambda one: re.match(_DEFINITION, one), statements))
    if len(lines) <= _LONG or not rest or len(rest) == len(statements):
        return lines
    return ["  (its definitions are in the output of --json)", *(_wrapped(one, "  ") for one in rest)]


def _wrapped(words: str, indent: str) -> str:
    return textwrap.fill(
        words, _WIDTH, initial_indent=indent, subsequent_indent=indent + "    ", break_on_hyphens=False
    )


def sentence(score: Score) -> str:
    """``R_G1 broken first at 2.1 s with car: gap(ego, car) has robustness -0.1 (worst -0.31 at 2.8 s)``."""
    verdict = f"{score.name} {'broken' if score.broken else 'kept'}"
    robustness = number(score.robustness)
    if score.nobody:
        return f"{verdict}: no vehicle to speak of{_left_out(score)}"
    if not score.pointwise or (score.broken and score.first is None):
        decided = "" if score.worst is None else f", decided {_place(score, score.worst)}"
        return f"{verdict} with robustness {robustness}{decided}"
    if score.first is None:
        least = "" if score.worst is None else f", least {_place(score, score.worst)}"
        return f"{verdict} with robustness {robustness}{least}"
    if score.worst is not None and score.worst.sample == score.first.sample:
        also = "" if number(score.first.value) == robustness else f" (robustness of the whole {robustness})"
        return f"{verdict} first and worst {_place(score, score.first)}{also}"
    # a part may be further from holding than the whole, which other parts excuse
    whole = " of the whole" if score.first.value < score.first.robustness else ""
    worst = "" if score.worst is None else f" at {clock(score.recording, score.worst.sample)} s"
    return f"{verdict} first {_place(score, score.first)} (worst robustness{whole} {robustness}{worst})"


def _place(score: Score, moment: Moment) -> str:
    """``at 2.1 s with cut_in: at 1.8 s speed(cut_in) > 3 has robustness -0.12``."""
    names = dict.fromkeys(name for key, name in moment.vehicles.items() if key not in moment.sought)
    nearest = dict.fromkeys(name for key, name in moment.vehicles.items() if key in moment.sought)
    words = f"at {clock(score.recording, moment.sample)} s"
    words += f" with {' and '.join(names)}" if names else ""
    if nearest:
        words += f", {'nearest' if score.broken else 'thanks to'} {' and '.join(nearest)}"
    other = f"at {clock(score.recording, moment.at)} s " if moment.at != moment.sample else ""
    return words + (f": {other}{_reason(moment)}" if moment.formula else "")


def _reason(moment: Moment) -> str:
    """``gap = -0.12``, or ``gap > 2 has robustness -0.5``, as has what is measured in units of its own."""
    term = re.fullmatch(r"(\w+)(\([^()]*\))?(?: >=? 0)?", moment.formula)
    if term is None:
        return f"{moment.formula} has robustness {number(moment.value)}"
    if term[2] is None:
        return f"{term[1]} = {number(moment.value)}"
    return f"{term[1]}{term[2]} has robustness {number(moment.value)}"


def _crowd(score: Score) -> str:
    recording = score.recording
    if "ego_x" not in recording.signals:
        return ""
    return f"; the ego and {', '.join(recording.names) or 'nobody else'}{_left_out(score)}"


def _left_out(score: Score) -> str:
    return f" (left out: {', '.join(score.excluded)})" if score.excluded else ""


def number(value: float) -> str:
    """Three significant digits; -0.00123, 12.3, inf."""
    return f"{value:.3g}"


def clock(recording: Recording, sample: int) -> str:
    """The time of a sample with the digits that the step needs: ``2.1``."""
    digits = next((k for k in range(1, 4) if abs(round(recording.dt, k) - recording.dt) < 1e-9), 3)
    return f"{recording.time(sample):.{digits}f}"


def chart(score: Score) -> list[Text]:
    """Robustness over time as bars, at most 80 columns wide; a bar is the least value of its samples."""
    values = score.prefix if score.body is None else score.body
    what = "of the samples so far" if score.body is None else "at each sample"
    bars = _binned(values)
    high, low = _reach(bars), _reach(-bars)
    labels = [_label(values, high), "0", _label(values, -low)]
    pad = max(map(len, labels))
    rows = [Text(f"robustness {what}")]
    for row in reversed(range(_ROWS_UP if high else 0)):
        cells = _cells(bars / high, row, _ROWS_UP, _UP)
        rows.append(_line(labels[0] if row == _ROWS_UP - 1 else "", pad, cells, "green"))
    for row in range(_ROWS_DOWN if low else 0):
        cells = _cells(-bars / low, row, _ROWS_DOWN, _DOWN)
        rows.append(_line("0" if row == 0 else labels[2] if row == _ROWS_DOWN - 1 else "", pad, cells, "red"))
    begin, end = (f"{clock(score.recording, t)} s" for t in (0, len(values) - 1))
    gap = " " * max(len(bars) - len(begin) - len(end), 1)
    return [*rows, Text(f"{'' if low else '0':>{pad}}  {begin}{gap}{end}")]


def _binned(values: Floats) -> Floats:
    """One value a column: the least of its samples, so that no violation is hidden."""
    if len(values) >= _COLUMNS:
        edges = np.arange(_COLUMNS) * len(values) // _COLUMNS
        return np.asarray(np.minimum.reduceat(values, edges))
    return np.repeat(values, _COLUMNS // len(values))


def _reach(values: Floats) -> float:
    """The largest finite value above zero; 1 where all of them are infinite, 0 where there are none."""
    above = values[values > 0.0]
    known = above[np.isfinite(above)]
    return float(known.max()) if len(known) else float(len(above) > 0)


def _label(values: Floats, edge: float) -> str:
    """The number at the end of an axis; infinity where no value on that side is finite."""
    if edge == 0.0:
        return ""
    known = np.isfinite(values[values * np.sign(edge) > 0.0]).any()
    return number(edge if known else math.copysign(math.inf, edge))


def _cells(shares: Floats, row: int, rows: int, blocks: str) -> str:
    """One row of a bar chart whose bars are ``shares`` of its height; any bar above 0 is seen."""
    full = len(blocks) - 1
    heights = np.ceil(np.clip(shares, 0.0, 1.0) * rows * full).astype(int)
    return "".join(blocks[min(max(height - row * full, 0), full)] for height in heights)


def _line(label: str, pad: int, cells: str, colour: str) -> Text:
    return Text.assemble(f"{label:>{pad}} ", ("▏", "dim"), (cells.rstrip(), colour))


def to_dict(score: Score) -> dict[str, Any]:
    """The score as plain data, ready for JSON; infinities become null."""
    recording = score.recording
    content = {
        "schema": 1,
        "source": recording.source,
        "specification": score.name,
        "formula": score.formula,
        "dt": recording.dt,
        "samples": recording.samples,
        "verdict": "broken" if score.broken else "kept",
        "robustness": score.robustness,
        "first": _plain(score, score.first),
        "worst": _plain(score, score.worst),
        "excluded": list(score.excluded),
        "time": recording.times.tolist(),
        "prefix": score.prefix.tolist(),
        "violated": score.violated.tolist(),
        "body": None if score.body is None else score.body.tolist(),
    }
    return finite(content)  # type: ignore[no-any-return]


def _plain(score: Score, moment: Moment | None) -> dict[str, Any] | None:
    if moment is None:
        return None
    return {
        "sample": moment.sample,
        "time": score.recording.time(moment.sample),
        "robustness": moment.robustness,
        "vehicles": moment.vehicles,
        "formula": moment.formula,
        "value": moment.value,
        "value_sample": moment.at,
        "value_time": score.recording.time(moment.at),
    }


def write_series(score: Score, path: Path) -> None:
    """Write time, robustness of the prefix, violation and body of every sample as CSV.

    Raises:
        OSError: It cannot be written.
    """
    columns: dict[str, Any] = {
        "time": [f"{t:.9g}" for t in score.recording.times],
        "robustness": score.prefix.tolist(),
        "violated": [str(bool(x)).lower() for x in score.violated],
    }
    if score.body is not None:
        columns["body"] = score.body.tolist()
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(zip(*columns.values(), strict=True))
    write_text(path, text.getvalue())
