"""Player of a stored rollout in a report: animation, charts on the same clock, predicates, noise."""

from __future__ import annotations

import math
import re
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from avrare.analysis.monitor.monitoring import MonitoringResult
from avrare.base.number_format import format_robustness
from avrare.driving.lanes import list_lanes
from avrare.driving.markings import list_markings
from avrare.report.html.drive_charts import DriveCharts, make_time_axis
from avrare.report.html.heat_strips import draw_noise, draw_predicates
from avrare.report.html.line_chart import LineChart, make_linear_scale, render_legend
from avrare.report.html.markup import Markup, json_block, tag
from avrare.report.html.stored_rollouts import MonitoredRollout, StoredRollout
from avrare.report.plots.rollout_plot import Frame
from avrare.report.terminal.monitoring_text import summarise
from avrare.rollout.problem import Problem
from avrare.stack.drawn_start import SIGNAL

_LEAD = 3.0  # time before the failure at which the player opens [s]
_MAX_SIGNALS = 12
_MAX_NUMBERS = 60_000  # largest size of plans and predictions; a longer rollout is shown without them


def render_player(
    rollout: MonitoredRollout, problem: Problem, opened: bool, folder: Path | None = None
) -> Markup:
    """Return everything about one rollout, synchronised by one clock.

    ``folder`` is that of the run, for the command that replays it.
    """
    stored, result = rollout.stored, rollout.result
    summary = tag("summary", tag("h3", stored.title), tag("span", _describe_rollout(stored), class_="muted"))
    anchor = None if stored.index is None else name_rollout(stored.specification, stored.index)
    if result is None:
        text = tag("p", f"It cannot be shown: {rollout.problem}.")
        return tag("details", summary, text, open=opened, id=anchor)
    decisive = [one for one in (result.first, result.worst) if one is not None]
    marked = sorted({name for one in decisive for name in one.vehicles.values()})
    return tag(
        "details", summary,
        tag("p", typeset_minus(summarise(result)), class_="sentence"),
        _render_lost(rollout),
        _render_difference(stored, result), _render_drawn(result),
        tag(
            "div", _render_stage(result), json_block(_tabulate_view(result, rollout.frames, marked)),
            DriveCharts(rollout, marked).render(), _draw_robustness(result),
            draw_predicates(problem.monitor(result.name), result),
            draw_noise(problem, stored.tape, stored.failed),
            class_="player", data_start=_select_start(result),
        ),
        _render_command(stored, folder),
        open=opened, id=anchor, class_="target",
    )  # fmt: skip


def name_rollout(specification: str, index: int) -> str:
    """Return the anchor of a stored failure in the report."""
    return f"failure-{specification}-{index}"


def _render_lost(rollout: MonitoredRollout) -> Markup | None:
    if rollout.not_continued:
        return tag("p", f"When it was lost could not be found: {rollout.not_continued}.", class_="sentence")
    if rollout.continuations is None:
        return None
    text = rollout.continuations.describe(rollout.violation)
    return tag("p", f"{text[0].upper()}{text[1:]}.", class_="sentence")


def _render_command(stored: StoredRollout, folder: Path | None) -> Markup | None:
    if folder is None or stored.index is None:
        return None
    words = ["avrare", "replay", "--run", str(folder), "--specification", stored.specification]
    words += ["--failure", str(stored.index), "--lost"]
    text = "The same in the terminal; --shrink finds what it needs, --csv and --rerun export it:"
    return tag(
        "div", tag("p", text, class_="muted"), tag("pre", shlex.join(words), class_="command", tabindex=0)
    )


def _render_drawn(result: MonitoringResult) -> Markup | None:
    drawn = {name: values for name, values in result.recording.signals.items() if name.startswith(SIGNAL)}
    rows = [
        tag("div", tag("dt", name.removeprefix(SIGNAL).replace("_", " ")), tag("dd", f"{values[0]:.4g}"))
        for name, values in drawn.items()
    ]
    return tag("div", tag("p", "Drawn at the start:"), tag("dl", rows, class_="facts")) if rows else None


def typeset_minus(text: str) -> str:
    """Replace the hyphens before numbers by minus signs."""
    return re.sub(r"(?<![\w.])-(?=[\d.])", "−", text)


def _describe_rollout(stored: StoredRollout) -> str:
    expected = math.sqrt(stored.tape.size)
    robustness = typeset_minus(format_robustness(stored.robustness))
    return f"robustness {robustness} · norm of the noise {stored.norm:.3g} (random rollouts: {expected:.3g})"


def _render_difference(stored: StoredRollout, result: MonitoringResult) -> Markup | None:
    now, then = result.robustness, stored.robustness
    if now == then:
        return None
    return tag(
        "p", f"Its robustness is now {typeset_minus(f'{now:.9g}')}, not {typeset_minus(f'{then:.9g}')} as "
        "stored: the version or the machine differs.", class_="note",
    )  # fmt: skip


def _select_start(result: MonitoringResult) -> int:
    """Return the sample at which the player opens: three seconds before what it is shown for."""
    decisive = result.first or result.worst
    before = round(_LEAD / result.recording.dt)
    return max(decisive.sample - before, 0) if decisive is not None else 0


def _render_stage(result: MonitoringResult) -> Markup:
    recording = result.recording
    start, last = _select_start(result), recording.samples - 1
    controls = tag(
        "div",
        tag("button", "Play", type="button", class_="play"),
        tag("input", type="range", min=0, max=last, step=1, value=start, aria_label="time"),
        tag("output", f"{recording.time(start):.2f} s"),
        tag("button", "1×", type="button", class_="speed", aria_label="playback speed"),
        class_="controls",
    )  # fmt: skip
    if recording.scene is None:
        return tag("div", _draw_signals(result), controls)
    description = f"Top view of the rollout: {summarise(result)}"
    key = render_legend(
        ("car ego", "ego"), ("car other", "others"), ("car decisive", "decides"), ("dot seen", "observed"),
        ("ring", "missed"), ("line accent", "plan"), ("line predicted", "predicted"),
    )  # fmt: skip
    canvas = tag("canvas", description, role="img", aria_label=description, class_="view")
    return tag("div", canvas, tag("div", key, class_="legend"), controls)


def _draw_signals(result: MonitoringResult) -> Markup:
    # scalar ones, those of the formula first
    scalar = [name for name, values in result.recording.signals.items() if np.ndim(values) == 1]
    chosen = sorted(scalar, key=lambda one: one not in result.formula)[:_MAX_SIGNALS]
    return tag("div", _draw_lines(result, chosen), class_="signals")


def _draw_lines(result: MonitoringResult, names: Sequence[str]) -> list[Markup]:
    times, x = make_time_axis(result)
    figures = []
    for name in names:
        values = np.asarray(result.recording.signals[name], dtype=np.float64)
        chart = LineChart(x, make_linear_scale(values.tolist()), f"Signal {name} over time", over_time=True)
        chart.draw_line(times, values, "accent")
        figures.append(chart.render(name, height=84))
    return figures


def _draw_robustness(result: MonitoringResult) -> Markup:
    times, x = make_time_axis(result)
    values = result.prefix if result.body is None else result.body
    title = f"Robustness over time, least {format_robustness(result.robustness)}"
    y = make_linear_scale([*values.tolist(), *result.prefix.tolist()], zero=True)
    chart = LineChart(x, y, title, "time [s]", over_time=True)
    chart.fill_below_zero(times, values)
    chart.draw_zero()
    entries = [("line dashed", "of the samples so far")]
    if result.body is not None:
        chart.draw_line(times, result.body, "accent")
        entries.insert(0, ("line accent", "at each sample"))
    chart.draw_line(times, result.prefix, "dashed")
    for decisive in (result.first, result.worst):
        if decisive is not None and math.isfinite(decisive.robustness):
            at = np.array([decisive.sample])
            chart.draw_dots(times[at], values[at], "violated" if result.violated else "accent")
    entries.append(("box violated", "violated"))
    return tag("div", chart.render("Robustness", render_legend(*entries), height=150), class_="gutter")


def _tabulate_view(
    result: MonitoringResult, frames: Sequence[Frame], marked: Sequence[str]
) -> dict[str, Any]:
    # Positions are in metres, to the centimetre.
    recording = result.recording
    content: dict[str, Any] = {"dt": recording.dt, "samples": recording.samples}
    scene = recording.scene
    if scene is None or not frames:
        return content
    road = scene.road
    content["road"] = {
        "lanes": list(road.lane_centres), "width": road.lane_width,
        "ramp": [*road.access_ramp, *road.shoulder, *road.opposing],
        "borders": [_round_points((one.stations, one.right, one.left)) for one in list_lanes(road)],
        "lines": [[*_round_points((one.x, one.y)), one.inner] for one in list_markings(road)],
    }  # fmt: skip
    content["ego"] = {"l": scene.ego_length, "w": scene.ego_width, **_encode_trajectory(frames, "ego", 0)}
    content["others"] = [
        {
            "name": name,
            "l": float(scene.lengths[v]),
            "w": float(scene.widths[v]),
            "moving": bool(scene.moving[v]),
            "marked": name in marked,
            **_encode_trajectory(frames, "others", (0, v)),
        }
        for v, name in enumerate(scene.names)
    ]
    content["seen"] = [_encode_observation(frame, len(scene.names)) for frame in frames]
    plans = [None if one.plan is None else _round_points(one.plan[:, :2]) for one in frames]
    predictions = [_encode_prediction(frame) for frame in frames]
    if _count_numbers(plans) + _count_numbers(predictions) <= _MAX_NUMBERS:
        content |= {"plan": plans, "predicted": predictions}
    return content


def _encode_trajectory(frames: Sequence[Frame], who: str, at: Any) -> dict[str, list[float]]:
    vehicles = [getattr(frame.world, who) for frame in frames]
    fields = (("x", "x", 2), ("y", "y", 2), ("h", "heading", 4), ("v", "speed", 2))
    found = {
        key: [_round(getattr(one, field)[at], digits) for one in vehicles] for key, field, digits in fields
    }
    # Between samples the player turns a vehicle by the difference: a half turn is passed without a jump.
    return {**found, "h": [_round(heading, 4) for heading in np.unwrap(found["h"])]}


def _encode_observation(frame: Frame, vehicles: int) -> list[list[float] | int] | None:
    # the observed position of each vehicle, 0 if it was missed, and those of false detections
    observed = frame.observation
    if observed is None:
        return None
    return [
        [_round(observed.x[0, v]), _round(observed.y[0, v])] if observed.detected[0, v] else 0
        for v in range(observed.x.shape[1])
        if v < vehicles or observed.detected[0, v]
    ]


def _encode_prediction(frame: Frame) -> list[list[list[float]]] | None:
    if frame.prediction is None:
        return None
    x, y = frame.prediction.x[0], frame.prediction.y[0]
    tracked = ~np.isinf(x).any(axis=-1)
    return [_round_points(np.stack(pair, axis=-1)) for pair in zip(x[tracked], y[tracked], strict=True)]


def _round_points(points: Any) -> list[list[float]]:
    return [[_round(value) for value in row] for row in points]


def _count_numbers(entries: Sequence[Any]) -> int:
    return sum(int(np.size(entry)) for entry in entries if entry is not None)


def _round(value: Any, digits: int = 2) -> float:
    return round(float(np.nan_to_num(value)), digits)  # JSON has no NaN
